// How a vessel's strip of the timeline is painted. What went wrong has a row of its own, so that it never has to stand
// out from a vessel's colour.

// Of a strip's height in pixels: above, what is seen; below it, what went wrong; on top, if the detector has several classes, wrong ones.
const SEEN_PX = 9, MARK_ROW_PX = 5, MIN_MARK_PX = 2, STRIPE_PX = 2, CLASS_PX = 3, STRIP_GAP_PX = 1, ROW_GAP_PX = 3;

function stripHeight(withClasses) {
  return seenTopOf(withClasses) + SEEN_PX + STRIP_GAP_PX + MARK_ROW_PX + ROW_GAP_PX;
}

function seenTopOf(withClasses) { return withClasses ? CLASS_PX + STRIP_GAP_PX : 0; }

// Paint the columns of a strip, each of which begins at `x` and counts frames: those in which the vessel is `seen`, the sum of its
// visible fractions (`fraction`), and what went wrong in them. The last column ends at `end`.
function paintStrip(context, columns, end, top, colour, withClasses) {
  const seenTop = top + seenTopOf(withClasses), markTop = seenTop + SEEN_PX + STRIP_GAP_PX;
  const hidden = channels(colourOf('--hidden')), own = channels(colour), alarm = colourOf('--alarm'), edge = colourOf('--edge');
  const rect = (fill, x, y, wide, high) => { context.fillStyle = fill; context.fillRect(x, y, wide, high); };
  rect(colourOf('--track'), columns[0].x, seenTop, end - columns[0].x, SEEN_PX);
  runs(columns, end, ({ seen, fraction }) => (seen ? mixed(hidden, own, fraction / seen) : ''), (fill, from, to) => {
    rect(fill, from, seenTop, to - from, SEEN_PX - 1);
    rect(edge, from, seenTop + SEEN_PX - 1, to - from, 1); // a pale colour too is seen to begin and to end
  });
  const marks = [
    ['bad', (high) => high / 2, true], ['off', (high) => high, true], ['missed', (high) => high, false],
  ];
  for (const [kind, part, striped] of marks) {
    const high = ({ [kind]: count, seen }) => (count ? Math.max(MIN_MARK_PX, Math.round(part((MARK_ROW_PX * count) / seen))) : 0);
    runs(columns, end, high, (tall, from, to) => {
      for (const [x, wide] of striped ? stripes(from, to) : [[from, to - from]]) rect(alarm, x, markTop + MARK_ROW_PX - tall, wide, tall);
    });
  }
  runs(columns, end, ({ mislabelled }) => mislabelled > 0, (_, from, to) => rect(alarm, from, top, to - from, CLASS_PX));
}

// Neighbours of one value in one go, from where they begin to where they end; nothing for what is empty, 0 or false.
function runs(columns, end, valueOf, paint) {
  let from = null, value = '';
  for (const column of [...columns, null]) {
    const next = column && valueOf(column), x = column?.x ?? end;
    if (next === value) continue;
    if (value) paint(value, from, x);
    [from, value] = [x, next];
  }
}

// Stripes from one place to another, at least one.
function stripes(from, to) {
  const found = [];
  for (let x = from; x < to; x += 2 * STRIPE_PX) found.push([x, Math.min(STRIPE_PX, to - x)]);
  return found;
}
