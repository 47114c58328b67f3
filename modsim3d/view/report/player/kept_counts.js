// Counts and moments of a recording with the detections that have a least confidence, as overview.py and count_tables.py count all.

const BUSY_MS = 12; // of counting without a break, so that the page never stands still
const KEPT = ['frame', 'taken', 'state', 'truthStart', 'vessel', 'flags', 'fraction', 'drawnStart', 'drawnVessel', 'outcome', 'confidence'];
const FATE = { unasked: 0, right: 1, class: 2, bad: 3, off: 4, missed: 5 }; // of a vessel, as VesselOutcome
const MARKED = ['missed', 'false', 'mislabelled', 'bad', 'off'];

// The columns of all parts that counts need, and the detection of each vessel. They are copied: the rest of a part is forgotten.
async function rowsToCount(recording, progress) {
  const { facts } = recording, found = [];
  for (let number = 0; number < facts.parts; number++) {
    const there = recording.parts.get(number), part = await (there ?? recording.unpack(number));
    const columns = Object.fromEntries(KEPT.filter((name) => part.columns[name]).map((name) => [name, part.columns[name].slice()]));
    found.push({ first: part.first, stop: part.stop, columns, found: detectionsIn(part, facts), fates: new Uint8Array(columns.vessel.length) });
    progress((number + 1) / facts.parts);
  }
  return found;
}

// Stretches of steps in which something is so without a break, of one camera, with a key such as the vessel.
class StretchList {
  constructor() { Object.assign(this, { last: new Map(), list: [] }); }

  add(key, index) {
    const last = this.last.get(key);
    if (last && index <= last.until + 1) last.until = index;
    else this.last.set(key, this.list[this.list.push({ key, index, until: index }) - 1]);
  }

  // In order of time, then of their keys.
  sorted() { return this.list.sort((a, b) => a.index - b.index || a.key - b.key); }
}

function emptyTally() {
  return { frames: 0, vessels: 0, partly: 0, wholly: 0, annotated: 0, detected: 0, right: 0, mislabelled: 0, bad: 0, off: 0, false: 0 };
}

// Counts of the columns of the timeline, and tallies in all and by camera, state and vessel; null if `goOn()` has become false.
async function countParts(recording, parts, least, goOn) {
  const { facts } = recording, many = (things) => things.map(emptyTally), counts = new CountsInBins(recording);
  const tallies = { all: emptyTally(), camera: many(facts.cameras), state: many(facts.states), vessel: many(facts.vessels) };
  const before = facts.cameras.map(() => -1), wide = facts.cameras.length;
  let since = performance.now();
  for (const part of parts) {
    const { columns } = part, { frame, taken, state } = columns;
    setFates(part, least);
    for (let index = part.first; index < part.stop; index++) {
      for (let camera = 0; camera < wide; camera++) {
        const cell = (index - part.first) * wide + camera, of = frame[cell], step = taken ? taken[cell] : index;
        if (step < 0) continue; // no frame yet
        counts.add(part, of, index, camera, least, facts.outcomes);
        if (step === before[camera]) continue; // counted before
        before[camera] = step;
        tallyFrame(part, of, least, facts.outcomes, [tallies.all, tallies.camera[camera], tallies.state[state[of]]], tallies.vessel);
      }
      if (performance.now() - since < BUSY_MS) continue;
      await new Promise((done) => setTimeout(done));
      if (!goOn()) return null;
      since = performance.now();
    }
  }
  return { columns: { ...recording.allColumns, ...counts.columns() }, tallies };
}

// What became of each vessel of a part; of what is wrong with its detection, the worst.
function setFates({ columns: { vessel, flags, drawnVessel, outcome, confidence }, found, fates }, least) {
  for (let row = 0; row < vessel.length; row++) {
    const drawn = found[row], own = drawn >= 0 && drawnVessel[drawn] === vessel[row] ? outcome[drawn] : 0;
    fates[row] = !(flags[row] & 1) ? FATE.unasked : !(flags[row] & 2) || confidence[drawn] / 1000 < least ? FATE.missed
      : own & 8 ? FATE.off : own & 4 ? FATE.bad : own & 2 ? FATE.class : FATE.right;
  }
}

// Count the rows of a frame in some tallies, and in those of its vessels.
function tallyFrame({ columns, fates }, frame, least, { FALSE_POSITIVE, MISLABELLED, BELOW_HALF_IOU, OFF_VESSEL }, of, ofVessels) {
  const { truthStart, vessel, fraction, drawnStart, drawnVessel, outcome, confidence } = columns, known = of.filter(Boolean);
  const add = (name, tallies) => { for (const tally of tallies) tally[name]++; };
  add('frames', known);
  for (let row = truthStart[frame]; row < truthStart[frame + 1]; row++) {
    const all = [...known, ofVessels[vessel[row]]];
    ofVessels[vessel[row]].frames++;
    add('vessels', all);
    if (fraction[row] === 0) add('wholly', all);
    else if (fraction[row] < WHOLE) add('partly', all);
    if (fates[row] !== FATE.unasked) add('annotated', all);
    if (fates[row] !== FATE.unasked && fates[row] !== FATE.missed) add('detected', all);
  }
  for (let row = drawnStart[frame]; row < drawnStart[frame + 1]; row++) {
    if (confidence[row] / 1000 < least) continue;
    const all = ofVessels[drawnVessel[row]] ? [...known, ofVessels[drawnVessel[row]]] : known;
    add(outcome[row] & FALSE_POSITIVE ? 'false' : 'right', all);
    if (outcome[row] & MISLABELLED) add('mislabelled', all);
    if (outcome[row] & BELOW_HALF_IOU) add('bad', all);
    if (outcome[row] & OFF_VESSEL) add('off', all);
  }
}

// What the timeline shows of mistakes, of each camera: counts in bins of steps, in all and of each vessel, and moments.
class CountsInBins {
  constructor({ facts: { overviews, vessels, length } }) {
    this.vessels = vessels.length;
    this.cameras = overviews.map(({ width }) => {
      const bins = Math.ceil(length / width), of = (size) => Object.fromEntries(MARKED.map((kind) => [kind, new Uint32Array(size)]));
      return { width, bins, counts: of(bins), ofVessels: of(bins * vessels.length), moments: Object.fromEntries(MARKED.map((kind) => [kind, new StretchList()])) };
    });
  }

  // Count what a camera shows at a step.
  add({ columns, fates }, frame, index, camera, least, { FALSE_POSITIVE, MISLABELLED, BELOW_HALF_IOU, OFF_VESSEL }) {
    const { truthStart, vessel, drawnStart, drawnVessel, outcome, confidence } = columns;
    for (let row = truthStart[frame]; row < truthStart[frame + 1]; row++) if (fates[row] === FATE.missed) this.mark(camera, 'missed', index, vessel[row]);
    for (let row = drawnStart[frame]; row < drawnStart[frame + 1]; row++) {
      if (confidence[row] / 1000 < least) continue;
      if (outcome[row] & FALSE_POSITIVE) {
        this.mark(camera, 'false', index, this.vessels);
        continue;
      }
      if (outcome[row] & MISLABELLED) this.mark(camera, 'mislabelled', index, drawnVessel[row]);
      if (outcome[row] & BELOW_HALF_IOU) this.mark(camera, 'bad', index, drawnVessel[row]);
      if (outcome[row] & OFF_VESSEL) this.mark(camera, 'off', index, drawnVessel[row]);
    }
  }

  mark(camera, kind, index, key) {
    const { width, bins, counts, ofVessels, moments } = this.cameras[camera], bin = Math.floor(index / width);
    counts[kind][bin]++;
    if (key < this.vessels) ofVessels[kind][key * bins + bin]++;
    moments[kind].add(key, index);
  }

  // With the names that overview.py gives them.
  columns() {
    const columns = {};
    this.cameras.forEach(({ counts, ofVessels, moments }, camera) => {
      for (const kind of MARKED) {
        const list = moments[kind].sorted();
        columns[`${camera}.${kind}`] = counts[kind];
        columns[`${camera}.vessels.${kind}`] = ofVessels[kind];
        columns[`${camera}.moments.${kind}.index`] = Uint32Array.from(list, ({ index }) => index);
        columns[`${camera}.moments.${kind}.long`] = Uint32Array.from(list, ({ index, until }) => until - index);
        columns[`${camera}.moments.${kind}.key`] = Uint16Array.from(list, ({ key }) => (key < this.vessels ? key : NONE));
      }
    });
    return columns;
  }
}

// Where the vessels of two recordings of the same truth fared differently, and how many both, one or none detected: by vessel and in all.
function countDifferences([{ facts }], parts) {
  const wide = facts.cameras.length, before = facts.cameras.map(() => -1), lists = facts.cameras.map(() => new StretchList());
  const paired = [...facts.vessels, null].map(() => ({ annotated: 0, both: 0, a: 0, b: 0, neither: 0 }));
  parts[0].forEach(({ first, stop, columns: { frame, taken, truthStart, vessel }, fates }, number) => {
    const others = parts[1][number].fates;
    for (let index = first; index < stop; index++) {
      for (let camera = 0; camera < wide; camera++) {
        const cell = (index - first) * wide + camera, step = taken ? taken[cell] : index, isNew = step >= 0 && step !== before[camera];
        if (isNew) before[camera] = step;
        for (let row = truthStart[frame[cell]]; row < truthStart[frame[cell] + 1]; row++) {
          const pair = [fates[row], others[row]], [a, b] = pair.map((fate) => fate !== FATE.missed);
          if (pair[0] !== pair[1]) lists[camera].add((vessel[row] * 8 + pair[0]) * 8 + pair[1], index);
          if (!isNew || pair[0] === FATE.unasked) continue;
          for (const count of [paired[vessel[row]], paired.at(-1)]) {
            count.annotated++;
            count[a && b ? 'both' : a ? 'a' : b ? 'b' : 'neither']++;
          }
        }
      }
    }
  });
  const found = lists.flatMap((each, camera) => each.sorted().map(({ key, index, until }) => (
    { camera, vessel: key >> 6, index, until, outcomes: [(key >> 3) & 7, key & 7] })));
  return { found, paired };
}
