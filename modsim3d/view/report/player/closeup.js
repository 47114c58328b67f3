// The close-up of one vessel: the one that was chosen; else of a mistake; else the one of before, while it is there; else the nearest.

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

  // Draw it, or the false positive that is chosen, mark its place in the image, and return its vessel and its place among
  // the false positives; null for what it is not of.
  draw(pane, frame, followed, shown, alarm, playing) {
    const { recording } = pane, { vessels } = recording.facts, of = (wanted) => frame.truths.find(({ vessel }) => vessel === wanted);
    const unasked = followed === null && alarm === null ? this.unasked(frame, of(this.before), playing) : { alarm, truth: of(followed) };
    if (unasked.alarm !== null) return this.drawAlarm(pane, frame, shown, unasked.alarm);
    const { truth } = unasked;
    this.before = truth?.vessel ?? this.before;
    if (truth) {
      this.picture.lookAt(truth.full, pane.size);
      this.picture.draw(recording, frame.index, pane.camera, shown, frame);
      pane.picture.mark(this.picture);
    } else {
      this.empty(followed === null ? 'No vessel is in the image' : `${vessels[followed].name} is not in the image`);
    }
    this.canvas.setAttribute('aria-label', `Close-up: ${truth ? vessels[truth.vessel].name : 'nothing'}`);
    return { vessel: truth?.vessel ?? null, alarm: null };
  }

  // What went wrong in the frame, the nearest missed vessel first; without a mistake the vessel of before, or the nearest. While the
  // run plays it stays with its vessel.
  unasked({ truths, detections }, before, playing) {
    const wrong = truths.filter((truth) => isWrong({ truth, found: detections.find((each) => each.vessel === truth.vessel && !each.false) }));
    const missed = wrong.filter((truth) => truth.missed), worst = missed.length ? missed : wrong, alarm = wrong.length ? -1 : detections.findIndex((each) => each.false);
    if (!(playing && before) && alarm >= 0) return { alarm };
    return { alarm: null, truth: (playing || worst.includes(before) || !worst.length) && before || (worst.length ? worst : truths).at(-1) };
  }

  drawAlarm(pane, frame, shown, alarm) {
    this.picture.lookAt(frame.detections[alarm].box, pane.size);
    this.picture.draw(pane.recording, frame.index, pane.camera, shown, frame);
    pane.picture.mark(this.picture);
    this.canvas.setAttribute('aria-label', 'Close-up: a false positive');
    return { vessel: null, alarm };
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
