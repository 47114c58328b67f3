// The address of what is shown: #step=120&camera=bow&beside=quay&vessel=ship2&layers=detections,missed&confidence=0.5. Names that are not there are passed over.

const SETTLED_MS = 250;

// The index of the first shown step that is not before the one asked for; null if none is asked for.
function indexInAddress(hash, { steps }) {
  const asked = /^\d+$/.exec(partsOf(hash).get('step') ?? '');
  if (!asked) return null;
  const found = steps.findIndex((step) => step >= Number(asked[0]));
  return found < 0 ? steps.length - 1 : found;
}

function partsOf(hash) { return new URLSearchParams(hash.replace(/^#/, '')); }

// The place of a name among things that have names; null if it is not there.
function placeOf(name, things) {
  const place = things.findIndex((thing) => thing.name === name);
  return place < 0 ? null : place;
}

// The layers that an address asks for, each with whether it is shown; null if it does not say.
function layersInAddress(hash, shown) {
  const asked = partsOf(hash).get('layers');
  if (asked === null) return null;
  const names = asked.split(',').filter((name) => Object.hasOwn(shown, name));
  return names.length || !asked ? Object.fromEntries(Object.keys(shown).map((name) => [name, names.includes(name)])) : null;
}

// What has its usual value is left out.
function addressOf({ index, stage, followed, shown, usual, threshold: { least }, recording: { facts } }) {
  const parts = [['step', facts.steps[index]]], names = Object.keys(shown);
  if (facts.cameras.length > 1) parts.push(['camera', facts.cameras[stage.panes[0].camera].name]);
  if (stage.besideName) parts.push(['beside', stage.besideName]);
  if (followed !== null) parts.push(['vessel', facts.vessels[followed].name]);
  if (least) parts.push(['confidence', least]);
  if (names.some((name) => shown[name] !== usual[name])) parts.push(['layers', names.filter((name) => shown[name]).join(',')]);
  return `#${parts.map(([name, value]) => `${name}=${encodeURIComponent(value).replaceAll('%2C', ',')}`).join('&')}`;
}

function writeAddress(player) {
  clearTimeout(writeAddress.timer);
  const address = addressOf(player);
  if (location.hash === address) return;
  try {
    history.replaceState(null, '', address);
  } catch {} // a page inside another has no address of its own
}

// Soon, but not at each step of many: browsers refuse to change the address too often. Not while the run plays.
function keepAddress(player) {
  clearTimeout(writeAddress.timer);
  writeAddress.timer = setTimeout(() => { if (!player.playing) writeAddress(player); }, SETTLED_MS);
}
