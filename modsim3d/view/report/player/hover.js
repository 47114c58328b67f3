// What is under the mouse in a picture: it stands out and is described; a press chooses it.

const NEAR_PX = 3, STILL_PX = 5;

// The smallest of the boxes that are drawn around a point of the canvas; null if there is none.
function boxUnder(pane, frame, shown, x, y) {
  const { picture } = pane, near = NEAR_PX / picture.scale, [atX, atY] = picture.toImage(x, y);
  const area = ([x0, y0, x1, y1]) => (x1 - x0) * (y1 - y0);
  return boxesOf(pane, frame, shown)
    .filter(({ box: [x0, y0, x1, y1] }) => atX >= x0 - near && atX <= x1 + near && atY >= y0 - near && atY <= y1 + near)
    .reduce((least, each) => (least && area(least.box) <= area(each.box) ? least : each), null);
}

// Each drawn box, with the vessel that it is of (null: of none) and, of a false positive, its place among the detections.
function boxesOf({ recording }, frame, shown) {
  const boxes = [];
  for (const truth of frame.truths) {
    const { vessel, visible, full, missed } = truth;
    if (shown.full) boxes.push({ box: full, vessel });
    if (visible && (shown.visible || shown.silhouettes || (shown.missed && missed))) boxes.push({ box: visible, vessel });
  }
  frame.detections.forEach((each, place) => {
    if (each.false ? shown.false : shown.detections) boxes.push({ box: each.box, vessel: each.false ? null : each.vessel, alarm: each.false ? place : null });
  });
  if (shown.tracks) for (const { box, vessel, lane } of recording.tracks(frame.index, frame.camera)) boxes.push({ box, vessel, lane });
  return boxes.map((each) => ({ alarm: null, lane: null, ...each }));
}

// A box in words, one line a fact.
function boxInWords({ vessel, alarm, lane }, frame, { facts }) {
  const track = lane === null ? [] : [`track ${facts.tracks.numbers[lane]}${vessel === null ? ' follows nothing' : ''}`];
  if (alarm !== null) return [...alarmInWords(frame.detections[alarm], facts), ...track];
  return vessel === null ? track : [...vesselInWords(vessel, frame, facts), ...track];
}

function alarmInWords({ kind, vessel, label, confidence, box: [x0, y0, x1, y1] }, { vessels }) {
  const of = vessel === null ? '' : ` of ${vessels[vessel].name}`;
  const what = kind === 'persistent_false_positive' ? 'false positive that stays' : kind === 'false_positive' ? 'false positive' : `false: ${kind}${of}`;
  return [what, `${label} ${confidence.toFixed(2)}`, `${(x1 - x0).toFixed(0)} × ${(y1 - y0).toFixed(0)} px`];
}

function vesselInWords(vessel, frame, { vessels, labels }) {
  const { name, label } = vessels[vessel], truth = frame.truths.find((each) => each.vessel === vessel);
  const found = frame.detections.find((each) => each.vessel === vessel && !each.false), lines = [labels.length > 1 ? `${name} (${label})` : name];
  if (truth) {
    const [distance, seen, became] = describe(truth, null), by = truth.hider && truth.fraction > 0 ? `, hidden by ${truth.hider}` : '';
    lines.push([distance, seen && `${seen} visible${by}`].filter((word) => word).join(', '));
    if (!found) lines.push(became);
  }
  if (found) {
    lines.push(`detected as ${found.label} ${found.confidence.toFixed(2)}`);
    lines.push([truth && `IoU ${iouInWords(found, truth)}`, found.mislabelled && 'wrong class', found.off && 'off its vessel'].filter((word) => word).join(', '));
  }
  return lines;
}

// From the box of the truth that was annotated; the page has 0.1 px of each side, so a value near 0.5 is put on the side that the run found.
function iouInWords({ box, bad }, { target }) {
  const value = intersectionOverUnion(box, target);
  return (bad ? Math.min(value, 0.49) : Math.max(value, 0.5)).toFixed(2);
}

function intersectionOverUnion(a, b) {
  const wide = Math.min(a[2], b[2]) - Math.max(a[0], b[0]), high = Math.min(a[3], b[3]) - Math.max(a[1], b[1]);
  const shared = Math.max(wide, 0) * Math.max(high, 0), area = ([x0, y0, x1, y1]) => (x1 - x0) * (y1 - y0);
  return shared / (area(a) + area(b) - shared);
}

class Hover {
  constructor(pane, player) {
    const { canvas } = pane;
    Object.assign(this, { pane, player, at: null, hit: null, pressed: null });
    this.tip = element('div', { className: 'tip hint', hidden: true });
    canvas.parentElement.append(this.tip);
    canvas.addEventListener('pointermove', ({ offsetX, offsetY, buttons, pointerType }) => this.move(buttons || pointerType === 'touch' ? null : [offsetX, offsetY]));
    canvas.addEventListener('pointerleave', () => this.move(null));
    canvas.addEventListener('pointerdown', ({ clientX, clientY, pointerType }) => { this.pressed = { x: clientX, y: clientY, by: pointerType }; });
    canvas.addEventListener('click', (event) => this.press(event));
  }

  move(at) {
    if (!at && !this.at) return;
    this.at = at;
    const before = this.hit;
    const frame = this.player.frameOf(this.pane);
    if (!frame) return; // nothing is drawn yet
    this.find(frame, this.player.shown);
    this.place();
    if (before?.vessel !== this.hit?.vessel || before?.alarm !== this.hit?.alarm || before?.lane !== this.hit?.lane) this.player.draw();
  }

  // A press that was no drag chooses the box, or nothing where there is none. A finger does not stay over the box, so
  // what it is is said in a message.
  press({ clientX, clientY, offsetX, offsetY }) {
    const { player, pane, pressed } = this, frame = player.frameOf(pane);
    if (!frame || pressed && Math.hypot(clientX - pressed.x, clientY - pressed.y) > STILL_PX) return;
    const hit = boxUnder(pane, frame, player.shown, offsetX, offsetY);
    player.choose(hit?.vessel ?? null, hit?.alarm ?? null);
    if (hit && pressed?.by === 'touch') say(`${pane.recording.facts.timestamps[frame.index]} s: ${boxInWords(hit, frame, pane.recording).join(' · ')}`);
  }

  // What the mouse is over in a frame; it is looked up anew in each, so that it is true while the run plays.
  find(frame, shown) {
    this.hit = this.at ? boxUnder(this.pane, frame, shown, ...this.at) : null;
    this.tip.hidden = !this.hit;
    this.pane.canvas.style.cursor = this.hit ? 'pointer' : '';
    if (this.hit) this.tip.textContent = boxInWords(this.hit, frame, this.pane.recording).join('\n');
    return this.hit;
  }

  // By the mouse, inside the picture.
  place() {
    if (!this.hit) return;
    const { tip, at: [x, y] } = this, { clientWidth, clientHeight } = this.pane.canvas;
    tip.style.left = `${x + 14 + tip.offsetWidth > clientWidth ? Math.max(x - tip.offsetWidth - 10, 0) : x + 14}px`;
    tip.style.top = `${y + 16 + tip.offsetHeight > clientHeight ? Math.max(y - tip.offsetHeight - 8, 0) : y + 16}px`;
  }
}
