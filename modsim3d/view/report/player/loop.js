// What plays again and again: the chosen moment with a little before and after it, or the whole run.

const MARGIN_S = 2;

// The frames of a moment and of two seconds on both sides.
function stretchAround({ index, until }, { times }) {
  const first = times.findIndex((time) => time >= times[index] - MARGIN_S), last = times.findLastIndex((time) => time <= times[until] + MARGIN_S);
  return { first, last };
}

class Loop {
  constructor(length) {
    Object.assign(this, { on: false, whole: { first: 0, last: length - 1 }, chosen: null });
  }

  // The stretch that plays again and again; null if none does.
  get stretch() { return this.on ? this.chosen ?? this.whole : null; }

  // The part of it that the timeline marks.
  get marked() { return this.on ? this.chosen : null; }

  aimAt(moment, facts) { this.chosen = stretchAround(moment, facts); }

  // A frame outside the chosen stretch ends the choice.
  leave(index) { if (this.chosen && (index < this.chosen.first || index > this.chosen.last)) this.chosen = null; }

  toggle() {
    this.on = !this.on;
    $('loop').setAttribute('aria-pressed', this.on);
    say(this.on ? `Repeats ${this.chosen ? `the chosen moment, with ${MARGIN_S} s before and after` : 'the whole run'}` : 'Repeats nothing');
  }
}
