// A lane per track of one camera, on the time axis of the timeline: which vessel it follows, its gaps, its switches.

const LANE_PX = 13, MIN_PX = 3, MARK_PX = 4;

class Lanes extends LanePanel {
  constructor(panel, recording, timeline) {
    super(panel, timeline, LANE_PX);
    Object.assign(this, { recording, found: [] });
  }

  // The lanes of a camera in the order of first appearance, each in stretches of one vessel.
  of(camera) {
    return this.found[camera] ??= lanesIn(this.recording, camera);
  }

  prepare(camera) {
    const { cameras, tracks } = this.recording.facts, of = cameras.length > 1 ? ` of ${cameras[camera].name}` : '';
    this.camera = camera;
    this.layOut(this.of(camera));
    $('lanesTitle').textContent = `Tracks${of}: ${this.lanes.length} of ${tracks.name}, in the order in which they begin`;
    $('lanesTitle').append(element('span', { className: 'in-least', textContent: ': as they are, whatever the confidence' }));
  }

  // The performance states, pale, behind all lanes.
  background() {
    const { context, timeline, recording } = this, { facts } = recording;
    context.globalAlpha = 0.45;
    for (const { index, until, state } of recording.states(this.camera)) {
      context.fillStyle = facts.states.length > 1 ? facts.colours.states[state] : colourOf('--track');
      context.fillRect(timeline.x(index), 0, timeline.x(until + 1) - timeline.x(index), this.high);
    }
    context.globalAlpha = 1;
  }

  lane(lane, top) {
    const { context, timeline, recording } = this, { facts } = recording, high = LANE_PX - 4;
    timeline.text(context, this.title(lane), 0, top + LANE_PX / 2, timeline.left - 6);
    for (const { from, to, vessel, pale } of lane.stretches.filter((each) => timeline.shows(each.from, each.to))) {
      const left = timeline.x(from), wide = Math.max(timeline.x(to) - left, MIN_PX);
      context.fillStyle = trackColour(vessel, facts);
      context.globalAlpha = pale ? 0.4 : 1;
      context.fillRect(left, top + 1, wide, vessel === null ? high / 2 : high);
      context.globalAlpha = 1;
    }
    context.fillStyle = colourOf('--ink');
    for (const { from, to } of this.occlusions(lane).filter((each) => timeline.shows(each.from, each.to))) {
      context.fillRect(timeline.x(from), top + high + 1, Math.max(timeline.x(to) - timeline.x(from), 1), 2);
    }
    for (const { index, switched } of lane.marks.filter((each) => timeline.shows(each.index))) this.mark(timeline.x(index), top, switched);
  }

  title({ number, vessel }) {
    return `${number} ${vessel === null ? 'false' : this.recording.facts.vessels[vessel].name}`;
  }

  // Where the vessel that the lane follows, or has followed last, is less than half seen.
  occlusions(lane) {
    if (lane.hidden) return lane.hidden;
    const half = this.recording.halfSeen(this.camera), found = [], pieces = lane.stretches;
    let vessel = null;
    pieces.forEach((piece, i) => {
      vessel = piece.vessel ?? vessel;
      const stop = pieces[i + 1]?.from ?? piece.to;
      for (const { index, until, key } of half) {
        if (key === vessel && index < stop && until >= piece.from) found.push({ from: Math.max(index, piece.from), to: Math.min(until + 1, stop) });
      }
    });
    return lane.hidden = found;
  }

  // A triangle: filled where the vessel had another track before, hollow where only the track had another vessel.
  mark(x, top, filled) {
    const { context } = this;
    context.beginPath();
    context.moveTo(x - MARK_PX, top - 1);
    context.lineTo(x + MARK_PX, top - 1);
    context.lineTo(x, top + 2 * MARK_PX - 1);
    context.closePath();
    Object.assign(context, { lineWidth: 1.2, fillStyle: colourOf(filled ? '--alarm' : '--paper'), strokeStyle: colourOf('--ink') });
    context.fill();
    context.stroke();
  }

  // Scroll to the first lane with a box at a step, unless one is in sight.
  reveal(index) {
    const first = this.panel.scrollTop / LANE_PX, stop = first + this.high / LANE_PX - 1;
    const there = this.lanes.flatMap((lane, at) => (this.at(lane, index) ? [at] : []));
    if (there.length && !there.some((at) => at >= first && at <= stop)) this.panel.scrollTop = there[0] * LANE_PX;
  }

  // The vessel that a lane follows at a step, or else mostly; null if there is no lane or it follows none.
  vesselOf(lane, index) { return lane && (this.at(lane, index)?.vessel ?? lane.vessel); }

  // What a lane shows at a step; null where it has no box.
  at(lane, index) { return lane.stretches.find(({ from, to }) => from <= index && index < to) ?? null; }

  // A step and a lane of it, if one is given, in words.
  hint(index, lane, camera) {
    const { recording } = this, { state } = recording.states(camera).findLast((each) => each.index <= index) ?? {};
    const when = stepInWords(recording, index, recording.facts.states[state] ?? '–');
    return lane ? `${when}\n${this.say(lane, index)}` : when;
  }

  // A lane at a step, in words.
  say(lane, index) {
    const { facts } = this.recording, overview = this.recording.overview(this.camera), here = this.at(lane, index), name = `track ${lane.number}`;
    if (!here) return `${name}: no box`;
    if (here.vessel === null) return `${name} follows nothing`;
    const bin = overview.binOf(index), of = (name) => overview.sum(name, here.vessel, bin, bin + 1), words = [`${name} follows ${facts.vessels[here.vessel].name}`];
    if (of('seen')) words.push(`${percent(of('fraction') / of('seen'))} visible`);
    const mark = lane.marks.find((each) => each.index === index);
    if (mark?.switched) words.push(`switch: the vessel had another track before`);
    if (mark?.moved) words.push(`switch: the track had another vessel before`);
    return words.join(', ');
  }
}

// The lanes of a camera, as track_columns.py has found them.
function lanesIn({ facts, columns }, camera) {
  const of = (name) => columns[`${camera}.lanes.${name}`], { numbers, flags } = facts.tracks, lanes = new Map();
  const [index, long, vessel, pale] = ['index', 'long', 'vessel', 'pale'].map(of);
  of('lane').forEach((lane, i) => {
    if (!lanes.has(lane)) lanes.set(lane, { number: numbers[lane], stretches: [], marks: [] });
    const follows = vessel[i] === NONE ? null : vessel[i];
    lanes.get(lane).stretches.push({ from: index[i], to: index[i] + long[i] + 1, vessel: follows, pale: pale[i] > 0 });
  });
  of('markLane').forEach((lane, i) => {
    const flag = of('markFlags')[i];
    lanes.get(lane).marks.push({ index: of('markIndex')[i], switched: (flag & flags.SWITCHED) > 0, moved: (flag & flags.MOVED) > 0 });
  });
  for (const lane of lanes.values()) lane.vessel = mostFollowed(lane);
  return [...lanes.values()];
}

// The vessel that a lane follows in most steps; null if it follows none.
function mostFollowed({ stretches }) {
  const steps = new Map();
  for (const { from, to, vessel } of stretches) if (vessel !== null) steps.set(vessel, (steps.get(vessel) ?? 0) + to - from);
  return [...steps].reduce((best, each) => (each[1] > best[1] ? each : best), [null, 0])[0];
}
