// The close-up of one vessel: the one that was chosen; else the one of before, while it is there; else the nearest.

const CLOSEUP_ASPECT = 2.2;

class Closeup {
  constructor(canvas) {
    this.canvas = canvas;
    this.before = null;
  }

  resize(pane) {
    if (this.of !== pane) [this.of, this.picture] = [pane, new pane.picture.constructor(this.canvas)];
    this.picture.resize(CLOSEUP_ASPECT);
  }

  // Draw it, or the false positive that is chosen, mark its place in the image, and return its vessel; null if there is none.
  draw(pane, frame, followed, shown, alarm = null) {
    if (alarm !== null) return this.drawAlarm(pane, frame, shown, frame.detections[alarm]);
    const { recording } = pane, { vessels } = recording.facts, wanted = followed ?? this.before;
    let truth = frame.truths.find(({ vessel }) => vessel === wanted);
    if (!truth && followed === null) truth = frame.truths.at(-1);
    this.before = truth?.vessel ?? this.before;
    if (truth) {
      this.picture.lookAt(truth.full, pane.size);
      this.picture.draw(recording, frame.index, pane.camera, shown, frame);
      pane.picture.mark(this.picture);
    } else {
      this.empty(followed === null ? 'No vessel is in the image' : `${vessels[followed].name} is not in the image`);
    }
    this.canvas.setAttribute('aria-label', `Close-up: ${truth ? vessels[truth.vessel].name : 'nothing'}`);
    return truth?.vessel ?? null;
  }

  drawAlarm(pane, frame, shown, { box }) {
    this.picture.lookAt(box, pane.size);
    this.picture.draw(pane.recording, frame.index, pane.camera, shown, frame);
    pane.picture.mark(this.picture);
    this.canvas.setAttribute('aria-label', 'Close-up: a false positive');
    return null;
  }

  empty(text) {
    const { context, ratio } = this.picture;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    context.fillStyle = colourOf('--soft');
    context.font = '14px system-ui, sans-serif';
    context.fillText(text, 14, 26);
  }
}
