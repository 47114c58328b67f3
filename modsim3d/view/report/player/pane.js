// A camera's image on the page: which camera of which recording it shows, and the part of the image in sight.

const WIDEST = 2, NARROW_PX = 480;

class Pane {
  // `number` counts the panes from 0; `run` is what the run is called where there are two.
  constructor(recording, camera, number = 0, run = '') {
    const { cameras, tracks } = recording.facts, node = $('pane').content.firstElementChild.cloneNode(true);
    const canvas = node.querySelector('canvas'), select = node.querySelector('select');
    Object.assign(this, { node, canvas, select, recording, run });
    [canvas.id, select.id] = number ? ['picture2', 'camera2'] : ['picture', 'camera'];
    cameras.forEach(({ name }, each) => select.add(new Option(name, each)));
    select.parentElement.hidden = cameras.length < 2;
    node.querySelector('.only').textContent = cameras.length < 2 ? `Camera ${cameras[0].name}` : '';
    node.querySelector('.run').textContent = run;
    this.picture = tracks ? new TrackPicture(canvas, NARROW_PX) : new Picture(canvas, NARROW_PX);
    this.show(camera);
    $('stage').append(node);
    canvas.addEventListener('loaded', () => window.player?.draw());
  }

  show(camera) { this.camera = this.select.value = camera; }

  get facts() { return this.recording.facts.cameras[this.camera]; }
  get size() { return this.facts.size; }
  get title() { return this.run ? `${this.facts.name} in ${this.recording.name}` : this.facts.name; }

  resize() {
    const [width, height] = this.size;
    this.picture.resize(Math.max(width / height, WIDEST));
  }

  // What the camera shows at a step.
  frame(index) { return frameOf(this.recording, index, this.camera); }

  draw(frame, shown, marked) {
    this.picture.draw(this.recording, frame.index, this.camera, shown, frame, marked);
    const text = absence(this.recording, frame);
    if (text) writeOn(this.picture, text);
  }

  // The part of the image in which vessels are, in any frame: between two rows.
  home([top, bottom]) {
    const [width, height] = this.size, high = width / this.picture.aspect;
    const middle = top > bottom ? height / 2 : (top + bottom) / 2;
    const y = Math.min(Math.max(middle - high / 2, 0), Math.max(height - high, (height - high) / 2));
    this.picture.fit([0, y, width, y + high]);
  }

  whole() { this.picture.fit([0, 0, ...this.size]); }

  zoom(factor, x = this.canvas.clientWidth / 2, y = this.canvas.clientHeight / 2) {
    const { picture } = this, { width } = picture.view;
    picture.zoom(width / widthWithin(width / factor, picture.aspect, this.size), x, y);
    this.stay();
  }

  move(byX, byY) {
    this.picture.view.x -= byX / this.picture.scale;
    this.picture.view.y -= byY / this.picture.scale;
    this.stay();
  }

  // Stay with the image.
  stay() { this.picture.view = viewWithin(this.picture.view, this.picture.aspect, this.size); }
}

// What a camera shows at a step.
function frameOf(recording, index, camera) {
  return { index, camera, shapes: recording.shapes(index, camera), truths: recording.truths(index, camera), detections: recording.detections(index, camera) };
}
