// Texts on the picture: IDs of vessels, and labels of boxes on plates.

const FONT_PX = 12, PLATE_PX = 17;

// IDs in the middle of what is seen of vessels, the nearest first; one that another is in the way of is left out.
function drawNames(picture, truths, vessels) {
  const { context } = picture, placed = [];
  context.font = `600 ${FONT_PX}px system-ui, sans-serif`;
  Object.assign(context, { lineJoin: 'round', lineWidth: 3, strokeStyle: '#000', fillStyle: '#fff' });
  for (const { visible, full, vessel } of truths.toReversed()) {
    const [x0, y0, x1, y1] = visible ?? full, { name } = vessels[vessel], wide = context.measureText(name).width;
    const [x, y] = picture.toCanvas((x0 + x1) / 2, (y0 + y1) / 2), left = x - wide / 2, base = y + FONT_PX / 3;
    if (placed.some((other) => left < other.left + other.wide && other.left < left + wide && Math.abs(base - other.base) < FONT_PX)) continue;
    placed.push({ left, wide, base });
    context.strokeText(name, left, base);
    context.fillText(name, left, base);
  }
}

const FARTHEST = 3; // rows of plates between a box and its own

// Texts on plates of their colours by their boxes, lines to them first; where other plates are in the way at its other end, farther
// off, or nowhere.
function drawPlates(picture) {
  const { context } = picture, width = picture.canvas.width / picture.ratio, height = picture.canvas.height / picture.ratio, placed = [];
  context.font = `${FONT_PX}px system-ui, sans-serif`;
  for (const { box: [x0, y0, x1, y1], text, colour, below, vessel, alarm, lane } of picture.plates) {
    const [left, top] = picture.toCanvas(x0, y0), [right, bottom] = picture.toCanvas(x1, y1);
    if (right < 0 || bottom < 0 || left > width || top > height) continue;
    const wide = context.measureText(text).width + 8, within = (x) => Math.min(Math.max(x, 0), Math.max(width - wide, 0));
    const over = top - PLATE_PX - 1, under = bottom + 2, ends = [within(left - 1), within(right - wide + 1)];
    const rows = (row) => [over - row * PLATE_PX, under + row * PLATE_PX].flatMap((y) => ends.map((x) => ({ x, y, edge: y < top ? top : bottom })));
    const places = below ? rows(0).slice(2) : [];
    for (let row = 0; row <= FARTHEST; row++) places.push(...rows(row));
    const clear = ({ x, y }) => y >= 0 && y <= height - PLATE_PX
      && placed.every((other) => x >= other.x + other.wide || other.x >= x + wide || Math.abs(y - other.y) >= PLATE_PX);
    const place = places.find(clear);
    if (place) placed.push({ ...place, wide, text, colour, left, of: { vessel, alarm, lane } });
  }
  for (const { x, y, wide, left, edge, colour, of } of placed) {
    picture.setOff(of);
    if (y + PLATE_PX < edge - 4 || y > edge + 4) drawLeader(picture, clamped(left, x + 3, x + wide - 3), y + PLATE_PX / 2, Math.max(left, 0), edge, colour);
  }
  for (const { x, y, wide, text, colour, of } of placed) {
    picture.setOff(of);
    context.fillStyle = colour;
    context.fillRect(x, y, wide, PLATE_PX - 1);
    context.fillStyle = inkOn(colour);
    context.fillText(text, x + 4, y + FONT_PX);
  }
  context.globalAlpha = 1;
}

// From a label that had to move to its box.
function drawLeader(picture, fromX, fromY, toX, toY, colour) {
  picture.context.beginPath();
  picture.context.moveTo(fromX, fromY);
  picture.context.lineTo(toX, toY);
  picture.stroke(colour, 1);
}

// Dark text on light plates, light on dark ones.
function inkOn(colour) {
  const [red, green, blue] = channels(colour);
  return 0.299 * red + 0.587 * green + 0.114 * blue > 112 ? '#111' : '#fff';
}

// A text over the middle of the picture.
function writeOn({ context, canvas, ratio }, text) {
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.font = '600 15px system-ui, sans-serif';
  const wide = Math.min(context.measureText(text).width, canvas.width / ratio - 24), left = (canvas.width / ratio - wide) / 2, top = 0.3 * canvas.height / ratio;
  context.fillStyle = '#000c';
  context.fillRect(left - 12, top - 14, wide + 24, 28);
  Object.assign(context, { fillStyle: '#fff', textBaseline: 'middle' });
  context.fillText(text, left, top, wide);
  context.textBaseline = 'alphabetic';
}
