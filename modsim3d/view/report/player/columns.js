// Columns of whole numbers, as recording/packing.py has packed them.

const NONE = 0xffff, NO_DEPTH = 0xffffffff;
const ARRAYS = { uint8: Uint8Array, uint16: Uint16Array, uint32: Uint32Array, int32: Int32Array, float32: Float32Array };
const WHOLE_ARRAYS = { 1: Uint8Array, 2: Uint16Array, 4: Uint32Array };
const ALIGNED_BYTES = 8;

// Columns by their names, from the text of gzipped bytes.
async function unpackColumns(text) {
  const letters = atob(text), zipped = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) zipped[i] = letters.charCodeAt(i);
  const stream = new Blob([zipped]).stream().pipeThrough(new DecompressionStream('gzip'));
  return readColumns(await new Response(stream).arrayBuffer());
}

function readColumns(bytes) {
  const long = new Uint32Array(bytes, 0, 1)[0], begin = ALIGNED_BYTES + long, columns = {};
  const index = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, ALIGNED_BYTES, long)));
  for (const entry of index) {
    const { name, type, length, offset, width } = entry;
    columns[name] = width ? decoded(entry, new Uint8Array(bytes, begin + offset), columns) : new ARRAYS[type](bytes, begin + offset, length);
  }
  return columns;
}

// A column that is stored as differences: bytes of zigzag numbers, the low ones of all first.
function decoded({ type, length, width, by, base }, bytes, columns) {
  const values = new ARRAYS[type](length), size = values.BYTES_PER_ELEMENT, whole = new WHOLE_ARRAYS[size](values.buffer);
  const from = base ? columns[base] : null, before = from || by === 'row' ? null : rowsBefore(by, columns);
  for (let i = 0; i < length; i++) {
    let zigzag = bytes[i];
    for (let place = 1; place < size; place++) zigzag |= bytes[place * length + i] << (8 * place);
    whole[i] = (zigzag >>> 1) ^ -(zigzag & 1);
  }
  if (from) {
    for (let i = 0; i < length; i++) whole[i] += from[i];
  } else if (by === 'row') {
    for (let i = width; i < length; i++) whole[i] += whole[i - width];
  } else if (before) {
    for (let row = 0; row < before.length; row++) {
      if (before[row] < 0) continue;
      for (let at = row * width, was = before[row] * width, stop = at + width; at < stop; at++, was++) whole[at] += whole[was];
    }
  }
  return values;
}

// The row that each row is a difference from, −1 for none; null if that is so for all.
function rowsBefore(by, columns) {
  if (by === null) return null;
  return by === 'outline' ? cornersBefore(columns) : sameBefore(columns[by]);
}

// The last row before each that has the same key.
function sameBefore(keys) {
  const last = new Map(), before = new Int32Array(keys.length);
  for (let row = 0; row < keys.length; row++) {
    before[row] = last.get(keys[row]) ?? -1;
    last.set(keys[row], row);
  }
  return before;
}

// For each corner that of the outline before of the same owner, if it has as many corners; else the corner before.
function cornersBefore({ outlineOwner, lineCount, cornerCount }) {
  const lines = beginnings(lineCount), corners = beginnings(cornerCount), before = new Int32Array(corners.at(-1));
  sameBefore(outlineOwner).forEach((last, outline) => {
    const first = corners[lines[outline]], stop = corners[lines[outline + 1]];
    const alike = last >= 0 && corners[lines[last + 1]] - corners[lines[last]] === stop - first;
    const shift = alike ? first - corners[lines[last]] : 1;
    for (let corner = first; corner < stop; corner++) before[corner] = corner - shift;
    if (!alike && first < stop) before[first] = -1;
  });
  return before;
}

// Where each of some stretches begins, and the end of the last, from their lengths.
function beginnings(lengths) {
  const begins = new Uint32Array(lengths.length + 1);
  for (let i = 0; i < lengths.length; i++) begins[i + 1] = begins[i] + lengths[i];
  return begins;
}
