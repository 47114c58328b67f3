// One frame as a picture: sky, sea, silhouettes, boxes. Image pixels become canvas pixels through a view.

const LAYERS = [
  ['silhouettes', 'Vessels'], ['full', 'Whole silhouette (box)'], ['visible', 'What is seen (box)'],
  ['detections', 'Detections'], ['false', 'False positives'], ['missed', 'Missed'], ['labels', 'Labels'],
];
const FONT_PX = 12, PLATE_PX = 17;

// A part of the image: left and top edge and width in image pixels; the height follows from the canvas.
class Picture {
  constructor(canvas) {
    this.canvas = canvas;
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

  zoom(factor, x, y) {
    const [imageX, imageY] = this.toImage(x, y), width = Math.min(Math.max(this.view.width / factor, 10), 1e5);
    const shrunk = width / this.view.width;
    this.view = { x: imageX - (imageX - this.view.x) * shrunk, y: imageY - (imageY - this.view.y) * shrunk, width };
  }

  draw(recording, index, camera, shown, frame) {
    const { context } = this, { colours, cameras } = recording.facts;
    this.placed = [];
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    context.save();
    this.background(cameras[camera].size, recording.horizon(index, camera), colours);
    if (shown.silhouettes) for (const truth of frame.truths) this.silhouette(recording, truth, colours);
    context.restore();
    for (const truth of frame.truths) {
      if (shown.full) this.box(truth.full, colours.truth, 1, [5, 4]);
      if (shown.visible && truth.visible) this.box(truth.visible, colours.truth, 1.2);
    }
    for (const detection of frame.detections) {
      const colour = detection.vessel === null ? colours.alarm : colours.vessels[detection.vessel];
      const text = `${detection.label} ${detection.confidence.toFixed(2)}`;
      if (detection.vessel === null && shown.false) this.marked(detection.box, colour, [7, 4], `false: ${text}`, shown.labels);
      if (detection.vessel !== null && shown.detections) this.marked(detection.box, colour, [], text, shown.labels);
    }
    if (!shown.missed) return;
    for (const truth of frame.truths.filter((each) => each.missed)) {
      const name = recording.facts.vessels[truth.vessel].name;
      this.marked(truth.target, colours.alarm, [], `missed: ${name}`, shown.labels, true);
    }
  }

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

  silhouette(recording, truth, colours) {
    this.path(recording.silhouette(truth.row));
    this.context.fillStyle = colours.hulls[truth.vessel];
    this.context.fill();
    this.stroke(colours.sea, 1);
  }

  path(corners) {
    this.context.beginPath();
    for (let i = 0; i < corners.length; i += 2) this.context.lineTo(...this.toCanvas(corners[i], corners[i + 1]));
    this.context.closePath();
  }

  // A box with a dark seam, so that a light line is seen on the sky too.
  box([x0, y0, x1, y1], colour, width, dash = []) {
    this.path([x0, y0, x1, y0, x1, y1, x0, y1]);
    this.stroke('#10182055', width + 2, dash);
    this.stroke(colour, width, dash);
  }

  stroke(colour, width, dash = []) {
    Object.assign(this.context, { strokeStyle: colour, lineWidth: width });
    this.context.setLineDash(dash);
    this.context.stroke();
    this.context.setLineDash([]);
  }

  marked(box, colour, dash, text, labelled, below = false) {
    this.box(box, colour, 2, dash);
    if (labelled) this.label(box, text, colour, below);
  }

  // Text on a plate of its colour by a box; where the plates of others are in the way farther off, or nowhere.
  label([x0, y0, x1, y1], text, colour, below) {
    const { context } = this, [left, top] = this.toCanvas(x0, y0), [right, bottom] = this.toCanvas(x1, y1);
    const width = this.canvas.width / this.ratio, height = this.canvas.height / this.ratio;
    if (right < 0 || bottom < 0 || left > width || top > height) return;
    context.font = `${FONT_PX}px system-ui, sans-serif`;
    const wide = context.measureText(text).width + 8;
    const x = Math.min(Math.max(left - 1, 0), Math.max(width - wide, 0)), step = below ? PLATE_PX : -PLATE_PX;
    let y = below ? bottom + 2 : top - PLATE_PX - 1;
    for (let attempt = 0; attempt < 5; attempt++, y += step) {
      const at = Math.min(Math.max(y, 0), height - PLATE_PX);
      if (this.placed.some(([px, py, pw]) => x < px + pw && px < x + wide && Math.abs(at - py) < PLATE_PX)) continue;
      this.placed.push([x, at, wide]);
      if (attempt) this.leader(x + 3, at + PLATE_PX / 2, left, below ? bottom : top, colour);
      context.fillStyle = colour;
      context.fillRect(x, at, wide, PLATE_PX - 1);
      context.fillStyle = '#111';
      context.fillText(text, x + 4, at + FONT_PX);
      return;
    }
  }

  // From a label that had to move to its box.
  leader(fromX, fromY, toX, toY, colour) {
    this.context.beginPath();
    this.context.moveTo(fromX, fromY);
    this.context.lineTo(toX, toY);
    this.stroke(colour, 1);
  }

  // The place of another picture in this one.
  mark(other) {
    const { x, y, width } = other.view, height = width / other.aspect;
    this.box([x, y, x + width, y + height], '#ffffffbb', 1, [2, 3]);
  }
}
