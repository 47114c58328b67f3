// The recording of a run: what its numbers mean, what the timeline shows, and its frames in parts that are unpacked when they
// are needed. Its other side is recording/recorder.py.

const UNKNOWN_FRACTION = 255, WHOLE = 250, STILL = 2 ** 31;
const MAX_PARTS = 8; // unpacked at once
const MAX_IMAGES = 64; // the user's pictures that are kept
const AROUND = 20; // steps before and after a frame that are made ready with it

async function openRecording(name) {
  if (!window.DecompressionStream) throw new Error('This browser is too old to unpack the recording; a newer one will do.');
  const facts = JSON.parse($(`facts-${name}`).textContent);
  const columns = await unpackColumns($(`overview-${name}`).textContent);
  Object.assign(facts, timesIn(facts, columns), { steps: stepsIn(facts) });
  return new Recording(name, facts, columns);
}

class Recording {
  constructor(name, facts, columns) {
    Object.assign(this, { name, facts, columns, allColumns: columns, length: facts.length, least: 0 });
    this.rowsRead = 0; // how many rows were looked at, so that a test can see that a frame costs no more than itself
    this.still = new Outlines(columns);
    this.parts = new Map(); // by number: a part that is unpacked, or the promise of it; the one used last comes last
    this.overviews = [];
    this.found = new Map();
  }

  // ---- parts

  // Whether the frames of a step can be shown at once.
  ready(index) { return this.parts.get(this.partOf(index)) instanceof Part; }

  // Make the frames of a step ready.
  async load(index) {
    const number = this.partOf(index), before = this.parts.get(number);
    if (before) return before;
    const promise = this.unpack(number);
    this.parts.set(number, promise);
    try {
      const part = await promise;
      this.parts.delete(number); // it is as good as used: others were while it was unpacked
      this.parts.set(number, part);
      this.forget();
      return part;
    } catch (error) {
      this.parts.delete(number);
      throw error;
    }
  }

  async unpack(number) {
    const { partSteps } = this.facts, text = await textOfPart(this.facts.folder, this.name, number);
    return new Part(await unpackColumns(text), number * partSteps, Math.min((number + 1) * partSteps, this.length));
  }

  // The picture that a camera has taken at a step, or nothing until it is there; `loaded` is called when it is.
  image(index, camera, loaded) {
    const { files, shown } = this.facts.images?.[camera] ?? {}, file = files?.[shown[index]];
    if (!file || (this.facts.keyframes && window.player?.playing)) return null; // single frames would flash by
    this.images ??= new Map();
    let image = this.images.get(file);
    if (!image) {
      image = new Image();
      image.addEventListener('load', () => loaded());
      image.src = file;
      this.images.set(file, image);
      if (this.images.size > MAX_IMAGES) this.images.delete(this.images.keys().next().value);
    }
    return image.complete && image.naturalWidth ? image : null;
  }

  // Make ready what may be wanted next.
  prefetch(index) {
    for (const near of [index - AROUND, index + AROUND]) if (near >= 0 && near < this.length && !this.ready(near)) this.load(near).catch(() => {}); // said when it is wanted
  }

  partOf(index) { return Math.floor(index / this.facts.partSteps); }

  // The part of a step, which must be ready.
  part(index) {
    const number = this.partOf(index), part = this.parts.get(number);
    if (!(part instanceof Part)) throw new Error(`Step ${index} is not ready: await recording.load(${index}) first.`);
    this.parts.delete(number);
    this.parts.set(number, part);
    return part;
  }

  forget() {
    const unpacked = [...this.parts].filter(([, part]) => part instanceof Part);
    for (const [number] of unpacked.slice(0, -MAX_PARTS)) this.parts.delete(number);
  }

  // ---- the whole run

  // Take other counts and moments for those of the timeline: of the detections that have a least confidence.
  count(columns) { Object.assign(this, { columns, overviews: [], found: new Map() }); }

  // What the timeline shows of a camera.
  overview(camera) {
    return this.overviews[camera] ??= new Overview(this.facts.overviews[camera], this.columns, camera, this.length);
  }

  // Moments of a kind that a camera sees, in order of time; frames in a row are one moment. Kinds are missed, false,
  // mislabelled, off, bad, hidden, and state for changes of the performance state.
  moments(camera, kind) {
    if (kind === 'state') return this.states(camera).slice(1).map(({ index, until, state }) => ({ index, until, state, vessel: null }));
    return this.once(`${camera} ${kind}`, () => momentsIn(this.columns, camera, kind).map(({ index, until, key }) => ({ index, until, vessel: key })));
  }

  // How many moments of a kind there are.
  momentCount(camera, kind) {
    return kind === 'state' ? this.moments(camera, kind).length : this.columns[`${camera}.moments.${kind}.index`].length;
  }

  // The performance states of a camera's frames, each with its first and last step; those of no frame are left out.
  states(camera) {
    const found = this.once(`${camera} state`, () => momentsIn(this.columns, camera, 'state'));
    return found.filter(({ key }) => key < this.facts.states.length).map(({ index, until, key }) => ({ index, until, state: key }));
  }

  // Where vessels are less than half visible to a camera; stored with tracks only.
  halfSeen(camera) { return this.once(`${camera} half`, () => momentsIn(this.columns, camera, 'half')); }

  once(key, find) {
    if (!this.found.has(key)) this.found.set(key, find());
    return this.found.get(key);
  }

  // ---- one step, which must be ready

  state(index, camera) {
    const part = this.part(index);
    return this.facts.states[part.columns.state[this.frameIn(part, index, camera)]] ?? '–';
  }

  // The frame that a camera shows at a step, by its number in the part: the last that it took.
  frameIn(part, index, camera) { return part.columns.frame[(index - part.first) * this.facts.cameras.length + camera]; }

  // When that frame was taken, in words, if it was not at this very step.
  age(index, camera) {
    const { first, columns: { taken } } = this.part(index);
    if (!taken) return '';
    const step = taken[(index - first) * this.facts.cameras.length + camera];
    return step < 0 ? 'no frame yet' : step === this.facts.steps[index] ? '' : `frame of step ${step}`;
  }

  // The rows of a table of a frame, by the name of the column that says where each frame's begin.
  rows(name, index, camera, row) {
    const part = this.part(index), frame = this.frameIn(part, index, camera), start = part.columns[name], rows = [];
    for (let at = start[frame]; at < start[frame + 1]; at++) {
      this.rowsRead++;
      rows.push(row(part.columns, at, part));
    }
    return rows;
  }

  // The side of the horizon on which the sea lies: a x + b y + c >= 0.
  horizon(index, camera) {
    const part = this.part(index), start = 3 * this.frameIn(part, index, camera);
    return part.columns.horizon.subarray(start, start + 3);
  }

  // What is to be painted, from back to front: whose it is, and which outline it has.
  shapes(index, camera) {
    return this.rows('shapeStart', index, camera, ({ owner, outline }, at, part) => (
      outline[at] >= STILL ? { owner: owner[at], outline: outline[at] - STILL, outlines: this.still }
        : { owner: owner[at], outline: outline[at], outlines: part.outlines }));
  }

  // The closed lines of a shape in pixels, each as x, y, x, y, ...
  lines({ outline, outlines }) { return outlines.lines(outline, this.facts.quantum); }

  // The vessels that are in the image, farthest first.
  truths(index, camera) { return this.rows('truthStart', index, camera, (columns, row, part) => this.truth(columns, row, part)); }

  // A vessel whose detection has less than the least confidence is not detected.
  truth(columns, row, part) {
    const { vessel, flags, fraction, depth, hider, confidence } = columns, found = detectionsIn(part, this.facts)[row];
    const annotated = (flags[row] & 1) > 0, detected = (flags[row] & 2) > 0 && !(confidence[found] / 1000 < this.least);
    const full = this.box(columns.full, row), visible = this.box(columns.visible, row);
    return {
      row, vessel: vessel[row], annotated, detected, missed: annotated && !detected,
      fraction: fraction[row] === UNKNOWN_FRACTION ? null : fraction[row] / WHOLE,
      depth: depth[row] === NO_DEPTH ? null : depth[row] / 100, hider: hider[row] === NONE ? null : this.facts.occluders[hider[row]].replace(/^obstacle:/, ''),
      full, visible, target: this.facts.mode === 2 ? visible ?? full : full,
    };
  }

  // The numbers of a row of the truth that no picture needs; null where a camera cannot know. The main hider comes first.
  numbers(index, row) {
    const { columns: { silhouettePx, hiddenPx, inFrame, hider, otherStart, otherName, otherPx } } = this.part(index), { occluders } = this.facts;
    const others = [];
    for (let at = otherStart[row]; at < otherStart[row + 1]; at++) others.push({ name: occluders[otherName[at]], px: otherPx[at] });
    const rest = others.reduce((px, other) => px - other.px, hiddenPx[row]);
    const hiders = hider[row] === NONE ? [] : [{ name: occluders[hider[row]], px: rest }, ...others];
    return { silhouettePx: silhouettePx[row], hiddenPx: hiddenPx[row], inFrame: inFrame[row] === NONE ? null : inFrame[row] / WHOLE_SILHOUETTE, hiders };
  }

  // What the detector put out with the least confidence or more, each with its number in the frame.
  detections(index, camera) {
    const every = this.rows('drawnStart', index, camera, ({ drawnVessel, label, confidence, outcome, kind, box }, row) => ({
      vessel: drawnVessel[row] === NONE ? null : drawnVessel[row], label: this.facts.labels[label[row]], kind: this.facts.kinds[kind[row]],
      confidence: confidence[row] / 1000, box: this.box(box, row), ...this.mistakes(outcome[row]),
    }));
    return every.map((each, number) => ({ number, ...each })).filter(({ confidence }) => confidence >= this.least);
  }

  // What is wrong with a detection: not the one of a vessel, another class than its vessel's, IoU below 0.5, a box that does not touch its vessel's.
  mistakes(outcome) {
    const { FALSE_POSITIVE, MISLABELLED, BELOW_HALF_IOU, OFF_VESSEL } = this.facts.outcomes;
    return { false: (outcome & FALSE_POSITIVE) > 0, mislabelled: (outcome & MISLABELLED) > 0, bad: (outcome & BELOW_HALF_IOU) > 0, off: (outcome & OFF_VESSEL) > 0 };
  }

  // The boxes of tracks.
  tracks(index, camera) {
    const { flags } = this.facts.tracks;
    return this.rows('trackStart', index, camera, ({ trackLane, trackVessel, trackFlags, trackBox }, row) => ({
      lane: trackLane[row], vessel: trackVessel[row] === NONE ? null : trackVessel[row], box: this.box(trackBox, row),
      pale: (trackFlags[row] & flags.UNSCORED) > 0, switched: (trackFlags[row] & flags.SWITCHED) > 0, moved: (trackFlags[row] & flags.MOVED) > 0,
    }));
  }

  // Where everything is, in metres and radians from above: null for a vessel that is absent, and for a camera whose vessel is.
  places(index) {
    const { first, columns } = this.parts.get(this.partOf(index)), { vessels, cameras } = this.facts, row = index - first, turn = 2 * Math.PI / 65536;
    const place = (values, at) => ({ x: values[2 * at] / 100, y: values[2 * at + 1] / 100 });
    return {
      vessels: vessels.map((_, i) => {
        const at = row * vessels.length + i;
        return columns.placed[at] ? { ...place(columns.place, at), heading: columns.heading[at] * turn } : null;
      }),
      cameras: cameras.map((_, i) => {
        const at = row * cameras.length + i, left = columns.cameraLooks[2 * at], right = columns.cameraLooks[2 * at + 1];
        const fov = ((left - right) & 0xffff) * turn;
        return columns.cameraPlaced[at] ? { ...place(columns.cameraPlace, at), yaw: right * turn + fov / 2, fov } : null;
      }),
    };
  }

  // x_min, y_min, x_max, y_max in pixels, or null.
  box(boxes, row) {
    const sides = boxes.subarray(4 * row, 4 * row + 4);
    return sides[0] === NONE ? null : Array.from(sides, (side) => side * this.facts.quantum);
  }
}
