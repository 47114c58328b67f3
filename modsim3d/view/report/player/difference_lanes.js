// A lane per vessel on which the runs differ: above where A did better, below where B did.

const DIFFERENCE_PX = 15, BETWEEN_PX = 3;

class DifferenceLanes {
  constructor(panel, canvas, differences, timeline) {
    Object.assign(this, { panel, canvas, differences, timeline, index: 0 });
    this.context = canvas.getContext('2d');
    panel.addEventListener('scroll', () => this.draw(this.index));
  }

  prepare(camera) {
    const { timeline } = this, lanes = Map.groupBy(this.differences.of(camera), ({ vessel }) => vessel);
    this.lanes = [...lanes].sort(([one], [other]) => one - other);
    const ratio = this.ratio = window.devicePixelRatio || 1, width = timeline.panel.parentElement.clientWidth;
    $('differencesSpace').style.height = `${this.lanes.length * DIFFERENCE_PX}px`;
    this.high = Math.min(this.panel.clientHeight, this.lanes.length * DIFFERENCE_PX);
    [this.canvas.width, this.canvas.height] = [Math.round(width * ratio), Math.round(this.high * ratio)];
    Object.assign(this.canvas.style, { width: `${width}px`, height: `${this.high}px` });
  }

  // Only the lanes in sight are drawn.
  draw(index) {
    this.index = index;
    if (!this.canvas.width || !this.canvas.height) return;
    const { context, timeline } = this, top = this.panel.scrollTop, x = timeline.x(index + 0.5);
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    Object.assign(context, { font: '12px system-ui, sans-serif', textBaseline: 'middle' });
    const stop = Math.min(this.lanes.length, Math.ceil((top + this.high) / DIFFERENCE_PX));
    for (let at = Math.floor(top / DIFFERENCE_PX); at < stop; at++) this.lane(this.lanes[at], at * DIFFERENCE_PX - top);
    for (const [colour, wide] of [['--paper', 5], ['--ink', 2]]) {
      context.fillStyle = colourOf(colour);
      context.fillRect(x - wide / 2, 0, wide, this.high);
    }
  }

  lane([vessel, list], top) {
    const { context, timeline } = this, half = (DIFFERENCE_PX - BETWEEN_PX) / 2;
    timeline.text(context, timeline.recording.facts.vessels[vessel].name, NAME_LEFT_PX, top + half, timeline.left - NAME_LEFT_PX - 6);
    context.fillStyle = colourOf('--track');
    context.fillRect(timeline.left, top, timeline.wide, 2 * half);
    for (const { index, until, outcomes: [a, b] } of list) {
      const left = timeline.x(index), wide = Math.max(timeline.x(until + 1) - left, 1);
      context.fillStyle = colourOf(a < b ? '--run-a' : '--run-b');
      context.fillRect(left, top + (a < b ? 0 : half), wide, half);
    }
  }

  laneAt(y) { return this.lanes[Math.floor((y + this.panel.scrollTop) / DIFFERENCE_PX)] ?? null; }

  vesselAt(y) { return this.laneAt(y)?.[0] ?? null; }

  // A step and a vessel of it, if one is given, in words.
  hint(index, y) {
    const { facts } = this.timeline.recording, when = `${facts.timestamps[index]} s, step ${facts.steps[index]}`, lane = this.laneAt(y);
    if (!lane) return when;
    const [vessel, list] = lane, here = list.find((each) => each.index <= index && index <= each.until);
    return `${when}\n${facts.vessels[vessel].name}: ${here ? LETTERS.map((letter, run) => `${letter} ${OUTCOMES[here.outcomes[run]]}`).join(', ') : 'no difference'}`;
  }
}
