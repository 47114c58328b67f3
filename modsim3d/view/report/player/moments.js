// Moments worth a look, of one kind: when something begins to be so, of which vessel, and until when it lasts.

// A vessel is occluded from when it is hidden by this much until it is seen but for that little, so that a flicker
// between 0.99 and 1 is no onset.
const BEGINS = 225, ENDS = 245; // visible, in 250ths

// What is so of a vessel at a step; false alarms are of no vessel.
const HOLDS = {
  missed: (summary, at) => summary.lost[at] > 0,
  mislabelled: (summary, at, { MISLABELLED }) => (summary.outcome[at] & MISLABELLED) > 0,
  off: (summary, at, { OFF_VESSEL }) => (summary.outcome[at] & OFF_VESSEL) > 0,
  bad: (summary, at, { BELOW_HALF_IOU }) => (summary.outcome[at] & BELOW_HALF_IOU) > 0,
};

// In order of time; frames in a row are one moment.
function findMoments(kind, summary, recording) {
  if (kind === 'state') return stateChanges(summary, recording);
  const { length, facts } = recording, moments = [];
  const collect = (vessel, test) => {
    for (let index = 0, last = null; index < length; index++) {
      if (!test(index, last !== null)) last = null;
      else if (last) last.until = index;
      else moments.push(last = { index, until: index, vessel });
    }
  };
  if (kind === 'false') collect(null, (index) => summary.false[index] > 0);
  else facts.vessels.forEach((_, vessel) => {
    const first = vessel * length, { fraction } = summary;
    if (kind === 'hidden') collect(vessel, (index, is) => Math.round(WHOLE * fraction[first + index]) <= (is ? ENDS : BEGINS));
    else collect(vessel, (index) => HOLDS[kind](summary, first + index, facts.outcomes));
  });
  return moments.sort((a, b) => a.index - b.index || a.vessel - b.vessel);
}

// Each lasts until the state changes again.
function stateChanges({ state }, { length, facts }) {
  const moments = [];
  for (let index = 1; index < length; index++) {
    if (state[index] !== state[index - 1] && state[index - 1] < facts.states.length) moments.push({ index, until: index, vessel: null, state: state[index] });
    else if (moments.length) moments.at(-1).until = index;
  }
  return moments;
}

class Moments {
  constructor(recording) {
    this.recording = recording;
    this.found = new Map(); // by camera and kind
    this.list = [];
    this.place = null;
  }

  // Those of a kind that a camera sees.
  of(camera, kind, summary) {
    const key = `${camera} ${kind}`;
    if (!this.found.has(key)) this.found.set(key, findMoments(kind, summary, this.recording));
    return this.found.get(key);
  }

  look(camera, kind, summary) {
    this.list = this.of(camera, kind, summary);
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

  // The one that was chosen last, while a frame of it is shown.
  at(index) {
    const current = this.list[this.place];
    return current && current.index <= index && index <= current.until ? current : null;
  }

  // In words; `until` where it lasts.
  text({ index, until, vessel, state }) {
    const { timestamps, vessels, states } = this.recording.facts;
    const when = until > index ? `${timestamps[index]}–${timestamps[until]} s` : `${timestamps[index]} s`;
    return [when, vessel === null ? states[state] : vessels[vessel].name].filter((word) => word).join(' ');
  }
}
