// One frame as a picture: sky, sea, silhouettes, boxes. Image pixels become canvas pixels through a view.

const LAYERS = [
  ['silhouettes', 'Silhouettes'], ['full', 'Truth: whole'], ['visible', 'Truth: seen'],
  ['detections', 'Detections'], ['false', 'False positives'], ['missed', 'Missed'], ['labels', 'Labels'], ['names', 'IDs'],
];

// A part of the image: left and top edge and width in image pixels; the height follows from the canvas.
class Picture {
  constructor(canvas, leastForNames = 0) {
    this.canvas = canvas;
    this.leastForNames = leastForNames; // narrower ones have confidences only in their labels
    this.context = canvas.getContext('2d');
    this.view = { x: 0, y: 0, width: 1 };
  }

  // Make the canvas as many pixels as it has on the screen. Returns whether that changed anything.
  resize(aspect) {
    const width = this.canvas.clientWidth, ratio = window.devicePixelRatio || 1;
    const size = [Math.round(width * ratio), Math.round((width / aspect) * ratio)];
    if (this.canvas.width === size[0] && this.canvas.height === size[1]) return false;
    [this.canvas.width, this.canvas.height] = size;
    this.canvas.style.height = `${width / aspect}px`;
    this.ratio = ratio;
    return true;
  }

  get aspect() { return this.canvas.width / this.canvas.height; }
  get scale() { return this.canvas.width / this.ratio / this.view.width; }

  toCanvas(x, y) { return [(x - this.view.x) * this.scale, (y - this.view.y) * this.scale]; }
  toImage(x, y) { return [x / this.scale + this.view.x, y / this.scale + this.view.y]; }

  // Show all of a box, with the canvas's aspect.
  fit([x0, y0, x1, y1]) {
    const width = Math.max(x1 - x0, (y1 - y0) * this.aspect);
    this.view = { x: (x0 + x1 - width) / 2, y: (y0 + y1 - width / this.aspect) / 2, width };
  }

  // Show a box with its surroundings, inside the image where that can be.
  lookAt([x0, y0, x1, y1], [width, height]) {
    const wide = Math.min(Math.max(3 * (x1 - x0), 3 * (y1 - y0) * this.aspect, 240), width, height * this.aspect);
    const within = (middle, span, limit) => Math.min(Math.max(middle - span / 2, 0), Math.max(limit - span, 0));
    const high = wide / this.aspect;
    this.view = { x: within((x0 + x1) / 2, wide, width), y: within((y0 + y1) / 2, high, height), width: wide };
  }

  // Whether the middle of a box is to be seen.
  shows([x0, y0, x1, y1]) {
    const [x, y] = this.toCanvas((x0 + x1) / 2, (y0 + y1) / 2), wide = this.canvas.width / this.ratio;
    return x >= 0 && y >= 0 && x <= wide && y <= wide / this.aspect;
  }

  zoom(factor, x, y) {
    const [imageX, imageY] = this.toImage(x, y), width = Math.min(Math.max(this.view.width / factor, 10), 1e5);
    const shrunk = width / this.view.width;
    this.view = { x: imageX - (imageX - this.view.x) * shrunk, y: imageY - (imageY - this.view.y) * shrunk, width };
  }

  // `marked`: the box that the mouse is over (hovered), for which the others fade, the one that is chosen, and notes by boxes.
  draw(recording, index, camera, shown, frame, marked = {}) {
    const { context } = this, { colours, cameras } = recording.facts;
    this.plates = [];
    this.hovered = marked.hovered ?? null;
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    context.save();
    this.background(cameras[camera].size, recording.horizon(index, camera), colours);
    const image = recording.image(index, camera, () => this.canvas.dispatchEvent(new Event('loaded')));
    if (image) context.drawImage(image, ...this.toCanvas(0, 0), ...cameras[camera].size.map((side) => side * this.scale));
    if (shown.silhouettes && !(image && recording.facts.keyframes)) for (const shape of frame.shapes) this.silhouette(recording, shape);
    context.restore();
    for (const truth of frame.truths) {
      const wider = this.setOff(truth);
      if (shown.full) this.box(truth.full, colours.truth, 1 + wider, [5, 4]);
      if (shown.visible && truth.visible) this.box(truth.visible, colours.truth, 1.2 + wider);
    }
    frame.detections.forEach((detection, place) => {
      if (detection.false ? shown.false : shown.detections) this.detection(detection, frame, recording.facts, detection.false ? place : null);
    });
    for (const { vessel, target } of frame.truths.filter((truth) => shown.missed && truth.missed)) {
      const { name } = recording.facts.vessels[vessel];
      this.setOff({ vessel });
      this.brackets(target, colours.alarm);
      this.plates.push({ vessel, box: target, colour: colours.alarm, text: this.narrow ? name : `missed: ${name}`, below: true });
    }
    context.globalAlpha = 1;
    drawChosen(this, marked.chosen);
    // Over all boxes: no line crosses a text.
    this.plates.push(...marked.notes ?? []);
    if (shown.names) drawNames(this, frame.truths, recording.facts.vessels);
    if (shown.labels) drawPlates(this);
  }

  // Fade what follows if the mouse is over another box. Returns by how much the lines of the box under the mouse are wider.
  setOff(box) {
    const same = !this.hovered || isSameBox(this.hovered, box);
    this.context.globalAlpha = same ? 1 : FADED;
    return this.hovered && same ? WIDER_PX : 0;
  }

  get narrow() { return this.canvas.width / this.ratio < this.leastForNames; }

  background([width, height], [a, b, c], colours) {
    const { context } = this, corners = [[0, 0], [width, 0], [width, height], [0, height]];
    this.path(corners.flat());
    context.fillStyle = colours.sky;
    context.fill();
    context.clip();
    const sea = [];
    corners.forEach((to, i) => {
      const from = corners[(i + 3) % 4], before = a * from[0] + b * from[1] + c, after = a * to[0] + b * to[1] + c;
      if (before >= 0 !== after >= 0) {
        const part = before / (before - after);
        sea.push(from[0] + part * (to[0] - from[0]), from[1] + part * (to[1] - from[1]));
      }
      if (after >= 0) sea.push(...to);
    });
    this.path(sea);
    context.fillStyle = colours.sea;
    context.fill();
  }

  // Filled where its lines wind around, holes left open; a vessel is set off from what is behind it.
  silhouette(recording, shape) {
    const { facts } = recording, { owner } = shape;
    this.context.beginPath();
    for (const line of recording.lines(shape)) this.closed(line);
    if (owner < facts.vessels.length) this.stroke(facts.colours.sea, 1.5);
    this.context.fillStyle = facts.colours.owners[owner];
    this.context.fill();
  }

  path(corners) {
    this.context.beginPath();
    this.closed(corners);
  }

  closed(corners) {
    this.context.moveTo(...this.toCanvas(corners[0], corners[1]));
    for (let i = 2; i < corners.length; i += 2) this.context.lineTo(...this.toCanvas(corners[i], corners[i + 1]));
    this.context.closePath();
  }

  // A detection: in long dashes where its box is bad, with a line to its vessel where it is off, with a filled corner where
  // its class is wrong; crossed out where it is false.
  detection({ vessel, box, label, kind, confidence, false: wrong, mislabelled, bad, off }, frame, { colours, vessels }, alarm) {
    const colour = wrong ? colours.alarm : colours.vessels[vessel], wider = this.setOff({ vessel, alarm });
    if (wrong) this.cross(box, colour);
    if (off) this.tether(box, frame.truths.find((truth) => truth.vessel === vessel).target, colours.alarm);
    this.box(box, colour, 2 + wider, wrong ? [5, 3] : bad ? [9, 6] : []);
    if (mislabelled) this.flag(box, colours);
    const words = this.narrow ? confidence.toFixed(2) : `${label} ${confidence.toFixed(2)}`;
    const remark = wrong ? `${kind.endsWith('false_positive') ? 'false' : kind}: ` : '';
    const text = this.narrow ? words : remark + words + (mislabelled ? `, ${isA(vessels[vessel].label)}` : '');
    this.plates.push({ vessel, alarm, box, colour: mislabelled ? colours.alarm : colour, text });
  }

  cross([x0, y0, x1, y1], colour) {
    this.path([x0, y0, x1, y1]);
    this.stroke(colour, 1);
    this.path([x0, y1, x1, y0]);
    this.stroke(colour, 1);
  }

  // A line from the middle of a box to the box that it should be at.
  tether([x0, y0, x1, y1], [left, top, right, bottom], colour) {
    const { context } = this, x = (x0 + x1) / 2, y = (y0 + y1) / 2, from = this.toCanvas(x, y);
    this.path([x, y, Math.min(Math.max(x, left), right), Math.min(Math.max(y, top), bottom)]);
    this.stroke('#10182055', 4);
    this.stroke(colour, 2);
    context.beginPath();
    context.arc(...from, 3.5, 0, 2 * Math.PI);
    context.fillStyle = colour;
    context.fill();
  }

  // The filled upper right corner of a box.
  flag([x0, y0, x1, y1], colours) {
    const { context } = this, [right, top] = this.toCanvas(x1, y0);
    const leg = Math.max(7, Math.min(15, 0.6 * this.scale * Math.min(x1 - x0, y1 - y0)));
    context.beginPath();
    context.moveTo(right + 1, top - 1);
    context.lineTo(right - leg, top - 1);
    context.lineTo(right + 1, top + leg);
    context.closePath();
    context.fillStyle = colours.alarm;
    context.fill();
    this.stroke(colours.ink, 1);
  }

  // A box with a dark seam, so that a light line is seen on the sky too.
  box([x0, y0, x1, y1], colour, width, dash = []) {
    this.path([x0, y0, x1, y0, x1, y1, x0, y1]);
    this.stroke('#10182055', width + 2, dash);
    this.stroke(colour, width, dash);
  }

  stroke(colour, width, dash = []) {
    Object.assign(this.context, { strokeStyle: colour, lineWidth: width, lineJoin: 'round' });
    this.context.setLineDash(dash);
    this.context.stroke();
    this.context.setLineDash([]);
  }

  // The four corners of a box, a little outside it.
  brackets([x0, y0, x1, y1], colour) {
    const [left, top] = this.toCanvas(x0, y0), [right, bottom] = this.toCanvas(x1, y1), gap = 3;
    const arm = Math.min(Math.max((right - left) / 4, (bottom - top) / 4, 5), 18);
    this.context.beginPath();
    for (const [x, toX] of [[left - gap, 1], [right + gap, -1]]) {
      for (const [y, toY] of [[top - gap, 1], [bottom + gap, -1]]) {
        this.context.moveTo(x + toX * arm, y);
        this.context.lineTo(x, y);
        this.context.lineTo(x, y + toY * arm);
      }
    }
    this.stroke('#10182055', 5);
    this.stroke(colour, 3);
  }

  // The place of another picture in this one.
  mark(other) {
    const { x, y, width } = other.view, height = width / other.aspect;
    this.box([x, y, x + width, y + height], '#ffffffbb', 1, [2, 3]);
  }
}

// What a wrongly labelled vessel is.
function isA(label) { return `is ${/^[aeiou]/i.test(label) ? 'an' : 'a'} ${label}`; }
