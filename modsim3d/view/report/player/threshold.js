// The least confidence of the detections that are shown, and what it makes of the counts.

// The detections of a frame that have a confidence, and its vessels, which are missed if none of theirs is left.
function atLeast(least, truths, detections) {
  if (!least) return { truths, detections };
  const kept = detections.filter(({ confidence }) => confidence >= least), of = (list) => new Set(list.flatMap((each) => (each.false ? [] : [each.vessel])));
  const before = of(detections), now = of(kept), isLost = ({ vessel, detected }) => detected && before.has(vessel) && !now.has(vessel);
  return { detections: kept, truths: truths.map((truth) => (isLost(truth) ? { ...truth, detected: false, missed: truth.annotated } : truth)) };
}

class Threshold {
  constructor(player) {
    Object.assign(this, { player, least: 0 });
    $('least').addEventListener('input', () => this.set(Number($('least').value)));
  }

  set(least) {
    const { player } = this;
    this.least = $('least').value = clamped(least, 0, 1);
    for (const recording of player.stage.recordings) recording.least = this.least;
    $('leastText').textContent = this.least.toFixed(2);
    player.alarm = null;
    player.draw();
    keepAddress(player);
    this.count();
  }

  // What the camera's counts over the whole run are with it, in words; they are looked up the first time.
  async count() {
    const { player, least } = this, { recording, camera } = player;
    if (!least) return $('leastCounts').textContent = '';
    const counts = (recording.confidences ??= [])[camera] ??= confidencesOf(recording, camera), found = await counts;
    if (least !== this.least || camera !== player.camera || recording !== player.recording) return;
    const below = (list) => list.filter((confidence) => confidence < least).length, lost = below(found.vessels);
    $('leastCounts').textContent = `All frames of ${recording.facts.cameras[camera].name}: ${found.detected - lost} detected, `
      + `${found.missed + lost} missed, ${found.alarms.length - below(found.alarms)} false positives. `
      + 'Tiles, timeline, moments and tables stay those of all detections.';
  }
}

// Of all frames of a camera: how many annotated vessels are detected and missed, the greatest confidence of each that is detected, and
// the confidences of false positives.
async function confidencesOf(recording, camera) {
  const found = { detected: 0, missed: 0, vessels: [], alarms: [] };
  let before = null;
  for (let index = 0; index < recording.length; index++) {
    const part = await recording.load(index), frame = recording.frameIn(part, index, camera);
    if (part === before?.part && frame === before.frame || recording.age(index, camera)) continue; // a frame that was counted, or none
    before = { part, frame };
    const detections = recording.detections(index, camera);
    for (const { vessel, annotated, detected, missed } of recording.truths(index, camera)) {
      found.detected += annotated && detected;
      found.missed += missed;
      const own = detections.filter((each) => each.vessel === vessel && !each.false).map(({ confidence }) => confidence);
      if (annotated && detected && own.length) found.vessels.push(Math.max(...own));
    }
    for (const each of detections) if (each.false) found.alarms.push(each.confidence);
  }
  return found;
}
