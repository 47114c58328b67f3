// How what is chosen or under the mouse stands out in the picture and on the timeline.

const FADED = 0.4, WIDER_PX = 1.5, HALO_GAP_PX = 9, HALO_ROUND_PX = 9;

// Whether a drawn box is of the same vessel, false positive or track as the one under the mouse.
function isSameBox(hit, { vessel = null, alarm = null, lane = null }) {
  if (hit.alarm !== null) return alarm === hit.alarm;
  return hit.vessel === null ? lane === hit.lane : alarm === null && vessel === hit.vessel;
}

// The box of what is chosen, if there is one: a ring around it, or an arrow to it.
function drawChosen(picture, box) {
  if (box) (picture.shows(box) ? drawHalo : drawArrowTo)(picture, box);
}

// A ring around a box, white with a dark seam, so that it is seen on sky, sea and hulls.
function drawHalo(picture, [x0, y0, x1, y1]) {
  const { context } = picture, [left, top] = picture.toCanvas(x0, y0), [right, bottom] = picture.toCanvas(x1, y1);
  context.beginPath();
  context.roundRect(left - HALO_GAP_PX, top - HALO_GAP_PX, right - left + 2 * HALO_GAP_PX, bottom - top + 2 * HALO_GAP_PX, HALO_ROUND_PX);
  picture.stroke('#000c', 6);
  picture.stroke('#fff', 2.5);
}

// An arrow at the edge of the picture, to a box that is out of sight.
function drawArrowTo(picture, [x0, y0, x1, y1]) {
  const { context } = picture, wide = picture.canvas.width / picture.ratio, high = wide / picture.aspect;
  const [toX, toY] = picture.toCanvas((x0 + x1) / 2, (y0 + y1) / 2), within = (value, limit) => Math.min(Math.max(value, 16), limit - 16);
  const x = within(toX, wide), y = within(toY, high);
  context.save();
  context.translate(x, y);
  context.rotate(Math.atan2(toY - y, toX - x));
  context.beginPath();
  context.moveTo(-8, -9);
  context.lineTo(8, 0);
  context.lineTo(-8, 9);
  context.closePath();
  picture.stroke('#000c', 6);
  context.fillStyle = '#fff';
  context.fill();
  context.restore();
}

// The box of a vessel or of a false positive that was chosen, if it is in this frame.
function chosenBox(frame, vessel, alarm) {
  const truth = vessel === null ? null : frame.truths.find((each) => each.vessel === vessel);
  if (truth) return truth.full;
  return alarm === null ? null : frame.detections[alarm]?.box ?? null;
}

// The stretch that plays again and again, if there is one.
function markStretch(timeline, stretch) {
  if (!stretch || !timeline.shows(stretch.first, stretch.last + 1)) return;
  const { context, height } = timeline, from = timeline.x(stretch.first), to = timeline.x(stretch.last + 1);
  context.fillStyle = colourOf('--accent');
  context.globalAlpha = 0.18;
  context.fillRect(from, 0, to - from, height);
  context.globalAlpha = 1;
  context.fillRect(from, 0, 2, height);
  context.fillRect(to - 2, 0, 2, height);
}
