// Moments worth a look, of one kind: when something begins to be so, of which vessel, and until when it lasts.

const KINDS = [
  ['missed', 'missed', (summary, at) => summary.lost[at] > 0],
  ['false', 'false alarm', null], // of no vessel
  ['mislabelled', 'wrong class', (summary, at, { MISLABELLED }) => (summary.outcome[at] & MISLABELLED) > 0],
  ['off', 'off its vessel', (summary, at, { OFF_VESSEL }) => (summary.outcome[at] & OFF_VESSEL) > 0],
  ['bad', 'IoU below 0.5', (summary, at, { BELOW_HALF_IOU }) => (summary.outcome[at] & BELOW_HALF_IOU) > 0],
  ['hidden', 'hidden in part', (summary, at) => summary.fraction[at] > 0 && summary.fraction[at] < 1],
];

// In order of time; frames in a row are one moment.
function findMoments(kind, summary, recording) {
  const { length, facts } = recording, [, , holds] = KINDS.find(([name]) => name === kind), moments = [];
  const collect = (vessel, test) => {
    for (let index = 0, last = null; index < length; index++) {
      if (!test(index)) last = null;
      else if (last) last.until = index;
      else moments.push(last = { index, until: index, vessel });
    }
  };
  if (holds === null) collect(null, (index) => summary.false[index] > 0);
  else facts.vessels.forEach((_, vessel) => collect(vessel, (index) => holds(summary, vessel * length + index, facts.outcomes)));
  return moments.sort((a, b) => a.index - b.index || a.vessel - b.vessel);
}

class Moments {
  constructor(recording) {
    this.recording = recording;
    this.found = new Map(); // by camera and kind
    this.list = [];
    this.place = null;
  }

  // Those of a kind that a camera sees.
  look(camera, kind, summary) {
    const key = `${camera} ${kind}`;
    if (!this.found.has(key)) this.found.set(key, findMoments(kind, summary, this.recording));
    this.list = this.found.get(key);
    this.place = null;
    return this.list;
  }

  // The moment before (−1) or after (1) a frame, or the neighbour of the one that was chosen last, if that is still shown.
  from(index, by) {
    const current = this.list[this.place];
    if (current?.index === index) return this.choose(this.place + by);
    const later = this.list.findIndex((moment) => moment.index > index), end = later < 0 ? this.list.length : later;
    if (by > 0) return this.choose(end);
    return this.choose(this.list.findLastIndex((moment) => moment.index < index));
  }

  choose(place) {
    if (!this.list[place]) return null;
    this.place = place;
    return this.list[place];
  }

  // In words; `until` where it lasts.
  text({ index, until, vessel }) {
    const { timestamps, vessels } = this.recording.facts;
    const when = until > index ? `${timestamps[index]}–${timestamps[until]} s` : `${timestamps[index]} s`;
    return vessel === null ? when : `${when} ${vessels[vessel].name}`;
  }
}
