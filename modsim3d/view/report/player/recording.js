// The recording: columns of numbers and what they mean. Its other side is recording.py.

const NONE = 0xffff, UNKNOWN_FRACTION = 255, WHOLE = 250;
const ARRAYS = { uint8: Uint8Array, uint16: Uint16Array, uint32: Uint32Array, int32: Int32Array, float32: Float32Array };

async function openRecording() {
  const facts = JSON.parse(document.getElementById('facts').textContent);
  if (!window.DecompressionStream) throw new Error('This browser is too old to unpack the recording; a newer one will do.');
  const text = atob(document.getElementById('columns').textContent);
  const packed = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) packed[i] = text.charCodeAt(i);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'));
  const bytes = await new Response(stream).arrayBuffer();
  const columns = {};
  for (const { name, type, offset, length } of facts.columns) columns[name] = new ARRAYS[type](bytes, offset, length);
  return new Recording(facts, columns);
}

class Recording {
  constructor(facts, columns) {
    this.facts = facts;
    this.columns = columns;
    this.length = facts.steps.length;
    this.rowsRead = 0; // how many rows were looked at, so that a test can see that a frame costs no more than itself
    this.lineStart = starts(columns.lineCount);
    this.cornerStart = starts(columns.cornerCount);
  }

  // The frame that a camera shows at a step: the last that it took.
  frame(index, camera) {
    const cell = index * this.facts.cameras.length + camera;
    return this.columns.frame ? this.columns.frame[cell] : cell;
  }

  // When that frame was taken, in words, if it was not at this very step.
  age(index, camera) {
    if (!this.columns.taken) return '';
    const step = this.columns.taken[index * this.facts.cameras.length + camera];
    return step < 0 ? 'no frame yet' : step === this.facts.steps[index] ? '' : `frame of step ${step}`;
  }

  state(index, camera) { return this.facts.states[this.columns.state[this.frame(index, camera)]] ?? '–'; }

  // The side of the horizon on which the sea lies: a x + b y + c >= 0.
  horizon(index, camera) {
    const start = 3 * this.frame(index, camera);
    return this.columns.horizon.subarray(start, start + 3);
  }

  // What is to be painted, from back to front: whose it is, and which outline it has.
  shapes(index, camera) {
    const frame = this.frame(index, camera), { shapeStart, owner, outline } = this.columns, shapes = [];
    for (let at = shapeStart[frame]; at < shapeStart[frame + 1]; at++) {
      this.rowsRead++;
      shapes.push({ owner: owner[at], outline: outline[at] });
    }
    return shapes;
  }

  // The closed lines of an outline in pixels, each as x, y, x, y, ...
  lines(outline) {
    const { corners } = this.columns, { quantum } = this.facts, lines = [];
    for (let line = this.lineStart[outline]; line < this.lineStart[outline + 1]; line++) {
      const part = corners.subarray(2 * this.cornerStart[line], 2 * this.cornerStart[line + 1]);
      lines.push(Array.from(part, (value) => value * quantum));
    }
    return lines;
  }

  // The vessels that are in the image, farthest first.
  truths(index, camera) {
    const frame = this.frame(index, camera), { truthStart } = this.columns, rows = [];
    for (let row = truthStart[frame]; row < truthStart[frame + 1]; row++) rows.push(this.truth(row));
    return rows;
  }

  truth(row) {
    this.rowsRead++;
    const { vessel, flags, fraction, depth, hider } = this.columns;
    const annotated = (flags[row] & 1) > 0, detected = (flags[row] & 2) > 0;
    const full = this.box('full', row), visible = this.box('visible', row);
    return {
      row, vessel: vessel[row], annotated, detected, missed: annotated && !detected,
      fraction: fraction[row] === UNKNOWN_FRACTION ? null : fraction[row] / WHOLE,
      depth: depth[row], hider: hider[row] === NONE ? null : this.facts.occluders[hider[row]],
      full, visible, target: this.facts.mode === 2 ? visible ?? full : full,
    };
  }

  // The numbers of a row of the truth that no picture needs; null where a camera cannot know. The main hider comes first.
  numbers(row) {
    const { silhouettePx, hiddenPx, inFrame, hider, otherCount, otherName, otherPx } = this.columns, { occluders } = this.facts;
    this.otherStart ??= starts(otherCount);
    const others = [];
    for (let at = this.otherStart[row]; at < this.otherStart[row + 1]; at++) others.push({ name: occluders[otherName[at]], px: otherPx[at] });
    const rest = others.reduce((px, other) => px - other.px, hiddenPx[row]);
    const hiders = hider[row] === NONE ? [] : [{ name: occluders[hider[row]], px: rest }, ...others];
    return { silhouettePx: silhouettePx[row], hiddenPx: hiddenPx[row], inFrame: inFrame[row] === NONE ? null : inFrame[row] / WHOLE_SILHOUETTE, hiders };
  }

  // What the detector put out.
  detections(index, camera) {
    const frame = this.frame(index, camera), { drawnStart, drawnVessel, label, confidence, outcome, kind } = this.columns, rows = [];
    for (let row = drawnStart[frame]; row < drawnStart[frame + 1]; row++) {
      this.rowsRead++;
      const vessel = drawnVessel[row];
      rows.push({
        vessel: vessel === NONE ? null : vessel, label: this.facts.labels[label[row]], kind: this.facts.kinds[kind[row]],
        confidence: confidence[row] / 1000, box: this.box('box', row), ...this.mistakes(outcome[row]),
      });
    }
    return rows;
  }

  // What is wrong with a detection: not the one of a vessel, another class than its vessel's, IoU below 0.5, a box that does not touch its vessel's.
  mistakes(outcome) {
    const { FALSE_POSITIVE, MISLABELLED, BELOW_HALF_IOU, OFF_VESSEL } = this.facts.outcomes;
    return { false: (outcome & FALSE_POSITIVE) > 0, mislabelled: (outcome & MISLABELLED) > 0, bad: (outcome & BELOW_HALF_IOU) > 0, off: (outcome & OFF_VESSEL) > 0 };
  }

  // x_min, y_min, x_max, y_max in pixels, or null.
  box(name, row) {
    const sides = this.columns[name].subarray(4 * row, 4 * row + 4);
    return sides[0] === NONE ? null : Array.from(sides, (side) => side * this.facts.quantum);
  }

  // What the timeline shows of a camera: for each step counts, and for each vessel and step its visible fraction and
  // what went wrong.
  summary(camera) {
    const { columns, length } = this, vessels = this.facts.vessels.length;
    const summary = {
      state: new Uint8Array(length), seen: new Uint16Array(length), annotated: new Uint16Array(length), missed: new Uint16Array(length),
      false: new Uint16Array(length), mislabelled: new Uint16Array(length), bad: new Uint16Array(length), off: new Uint16Array(length),
      fraction: new Float32Array(vessels * length).fill(NaN), lost: new Uint8Array(vessels * length),
      outcome: new Uint8Array(vessels * length),
      rows: [Infinity, -Infinity], // of the image: the least and the greatest that a vessel reaches
    };
    for (let index = 0; index < length; index++) {
      const frame = this.frame(index, camera);
      summary.state[index] = columns.state[frame];
      summary.seen[index] = columns.truthStart[frame + 1] - columns.truthStart[frame];
      for (let row = columns.truthStart[frame]; row < columns.truthStart[frame + 1]; row++) {
        const at = columns.vessel[row] * length + index, fraction = columns.fraction[row];
        const missed = columns.flags[row] === 1;
        summary.fraction[at] = fraction === UNKNOWN_FRACTION ? 1 : fraction / WHOLE;
        summary.lost[at] = missed ? 1 : 0;
        summary.annotated[index] += columns.flags[row] & 1;
        summary.missed[index] += missed ? 1 : 0;
        summary.rows[0] = Math.min(summary.rows[0], columns.full[4 * row + 1] * this.facts.quantum);
        summary.rows[1] = Math.max(summary.rows[1], columns.full[4 * row + 3] * this.facts.quantum);
      }
      for (let row = columns.drawnStart[frame]; row < columns.drawnStart[frame + 1]; row++) {
        const { false: wrong, mislabelled, bad, off } = this.mistakes(columns.outcome[row]);
        if (wrong) {
          summary.false[index]++;
          continue;
        }
        summary.outcome[columns.drawnVessel[row] * length + index] = columns.outcome[row];
        summary.mislabelled[index] += mislabelled ? 1 : 0;
        summary.bad[index] += bad ? 1 : 0;
        summary.off[index] += off ? 1 : 0;
      }
    }
    return summary;
  }
}

// Where each of some stretches begins, and the end of the last, from their lengths.
function starts(lengths) {
  const begins = new Uint32Array(lengths.length + 1);
  lengths.forEach((length, i) => { begins[i + 1] = begins[i] + length; });
  return begins;
}
