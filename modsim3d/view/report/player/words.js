// What is said of vessels and detections, in words.

function describe(truth, detection) {
  const seen = truth.fraction === null ? '' : percent(truth.fraction), by = truth.hider ? ` by ${truth.hider}` : '';
  const as = detection?.mislabelled ? `as ${detection.label}` : 'detected', how = detection?.off ? ', off it' : detection?.bad ? ', IoU\u00a0<\u00a00.5' : '';
  const found = `${as} ${detection?.confidence.toFixed(2) ?? ''}${how}`;
  const what = truth.missed ? 'missed' : truth.detected ? found : truth.fraction === 0 ? 'hidden' : 'not annotated';
  return [truth.depth === null ? '' : inMetres(truth.depth), seen, truth.fraction === 0 ? `hidden${by}` : what];
}

// What is wrong with a detection of a vessel.
function wordsFor({ mislabelled, bad, off }) {
  return [mislabelled && 'wrong class', off ? 'off its vessel' : bad && 'IoU below 0.5'].filter((word) => word);
}

function some(count, text) { return count ? `${count} ${text}` : ''; }

function falsePositives(count) { return `${whole(count)} false positive${count === 1 ? '' : 's'}`; }

// Whole metres, with commas in thousands.
function inMetres(metres) { return `${Math.round(metres).toLocaleString('en')} m`; }

// Never all or nothing where a part is seen.
function percent(fraction) {
  const rounded = Math.round(100 * fraction);
  return `${fraction > 0 && fraction < 1 ? Math.min(Math.max(rounded, 1), 99) : rounded} %`;
}

// What there is in a frame.
function frameInWords(recording, { index, camera, truths, detections }) {
  const { facts, length } = recording, count = (test) => detections.filter(test).length, wrong = count((each) => each.false);
  return [
    `${facts.timestamps[index]} s`, `step ${facts.steps[index]} of ${facts.steps[length - 1]}`,
    recording.age(index, camera), `detector ${recording.state(index, camera)}`, `${truths.length} in the image`,
    `${detections.length - wrong} detected`, `${truths.filter((truth) => truth.missed).length} missed`, falsePositives(wrong),
    some(count(({ mislabelled }) => mislabelled), 'of a wrong class'), some(count(({ bad }) => bad), 'with IoU below 0.5'),
    some(count(({ off }) => off), 'off their vessel'),
  ].filter((word) => word).join(' · ');
}

// Why there is no vessel to see in a frame, and when there is one; empty where one is in the image.
function absence(recording, { index, camera, truths }) {
  const { timestamps } = recording.facts, overview = recording.overview(camera), { seen } = overview;
  if (recording.age(index, camera) === 'no frame yet') return 'no frame yet';
  if (truths.length) return '';
  if (!seen.some((count) => count)) return 'no vessel is ever in this image';
  const next = seen.findIndex((count, bin) => count > 0 && overview.firstOf(bin) > index);
  return next < 0 ? 'no vessel is in the image any more' : `no vessel is in the image: the next at ${timestamps[overview.firstOf(next)]} s`;
}

function stepsInWords({ facts }, first, last, state) {
  return `${facts.timestamps[first]}–${facts.timestamps[last]} s, steps ${facts.steps[first]} to ${facts.steps[last]}: detector ${state}`;
}

// What became of a vessel in a bin of an overview; how often, where it has several steps.
function vesselInBin(overview, vessel, bin) {
  const of = (name) => overview.sum(name, vessel, bin, bin + 1), seen = of('seen'), long = overview.stopOf(bin) - overview.firstOf(bin);
  if (!seen) return ['not in the image'];
  const often = (name, word) => of(name) > 0 && (long > 1 ? `${word} in ${of(name)}` : word);
  const off = often('off', 'off its vessel'), bad = often('bad', 'IoU below 0.5'), share = `${percent(of('fraction') / seen)} visible`;
  const words = [long > 1 ? `in ${seen} of ${long} steps, ${share}` : share, often('missed', 'missed'), often('mislabelled', 'wrong class'), off];
  return [...words, (long > 1 || !off) && bad].filter((word) => word);
}

function stepInWords({ facts }, index, state) { return `${facts.timestamps[index]} s, step ${facts.steps[index]}: detector ${state}`; }
