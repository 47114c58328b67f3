// Where two runs of the same truth differ: what the detectors A and B made of the same vessels. Its other side is run_differences.py.

const OUTCOMES = ['', 'right', 'IoU below 0.5', 'wrong class', 'off its vessel', 'missed']; // from good to bad
const DIFFERENCE_PX = 14;

class Differences {
  constructor({ camera, vessel, index, until, outcomes }, facts) {
    this.facts = facts;
    this.byCamera = facts.cameras.map(() => []);
    camera.forEach((of, row) => this.byCamera[of].push(
      { vessel: vessel[row], index: index[row], until: until[row], a: outcomes[2 * row], b: outcomes[2 * row + 1] },
    ));
    this.moments = this.byCamera.map((list) => [...list].sort((one, other) => one.index - other.index || one.vessel - other.vessel));
  }

  // Of one camera by vessel, those that have any; each in order of time.
  byVessel(camera) { return Map.groupBy(this.byCamera[camera], ({ vessel }) => vessel); }

  // The differences at a step, by vessel.
  at(camera, index) {
    return new Map(this.byCamera[camera].filter((each) => each.index <= index && index <= each.until).map((each) => [each.vessel, each]));
  }

  // What the other run made of a vessel.
  static said(difference, run) { return OUTCOMES[run === 'A' ? difference.a : difference.b]; }
}

// A lane per vessel on which the runs differ: above where A did better, below where B did.
class DifferenceLanes {
  constructor(panel, canvas, differences, timeline) {
    Object.assign(this, { panel, canvas, differences, timeline });
    this.context = canvas.getContext('2d');
  }

  prepare(camera) {
    this.lanes = [...this.differences.byVessel(camera)].sort(([one], [other]) => one - other);
    const ratio = this.ratio = window.devicePixelRatio || 1, width = this.timeline.canvas.clientWidth;
    this.height = Math.max(this.lanes.length * DIFFERENCE_PX, 1);
    [this.canvas.width, this.canvas.height] = [Math.round(width * ratio), Math.round(this.height * ratio)];
    Object.assign(this.canvas.style, { width: `${width}px`, height: `${this.height}px` });
  }

  draw(index) {
    const { context, timeline } = this;
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    Object.assign(context, { font: '11px system-ui, sans-serif', textBaseline: 'middle' });
    this.lanes.forEach(([vessel, list], i) => this.lane(vessel, list, i * DIFFERENCE_PX));
    const x = timeline.x(index + 0.5);
    for (const [colour, wide] of [['--paper', 5], ['--ink', 2]]) {
      context.fillStyle = colourOf(colour);
      context.fillRect(x - wide / 2, 0, wide, this.height);
    }
  }

  lane(vessel, list, top) {
    const { context, timeline } = this, high = DIFFERENCE_PX - 3;
    timeline.text(context, this.differences.facts.vessels[vessel].name, 0, top + high / 2, timeline.left - 6);
    context.fillStyle = colourOf('--track');
    context.fillRect(timeline.left, top, timeline.wide, high);
    for (const { index, until, a, b } of list) {
      const left = timeline.x(index), wide = Math.max(timeline.x(until + 1) - left, 1);
      context.fillStyle = colourOf(a < b ? '--run-a' : '--run-b');
      context.fillRect(left, top + (a < b ? 0 : high / 2), wide, high / 2);
    }
  }

  vesselAt(y) { return this.lanes[Math.floor(y / DIFFERENCE_PX)]?.[0] ?? null; }
}
