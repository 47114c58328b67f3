// Moments worth a look, of one kind: when something begins to be so, of which vessel, and until when it lasts.

class Moments {
  constructor(recording, differences) {
    this.recording = recording;
    this.differences = differences;
    this.list = [];
    this.place = null;
  }

  // Those of a kind that a camera sees.
  of(camera, kind) {
    if (kind === 'differs') return this.differences?.of(camera) ?? [];
    return this.recording.moments(camera, kind);
  }

  count(camera, kind) {
    return kind === 'differs' ? this.of(camera, kind).length : this.recording.momentCount(camera, kind);
  }

  look(camera, kind) {
    this.list = this.of(camera, kind);
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
  text({ index, until, vessel, state }) {
    const { timestamps, vessels, states } = this.recording.facts;
    const when = until > index ? `${timestamps[index]}–${timestamps[until]} s` : `${timestamps[index]} s`;
    return [when, vessel === null ? states[state] : vessels[vessel].name].filter((word) => word).join(' ');
  }
}
