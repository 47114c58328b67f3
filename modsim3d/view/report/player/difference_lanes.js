// A lane per vessel on which the runs differ: above where A did better, below where B did.

const DIFFERENCE_PX = 15, BETWEEN_PX = 3;

class DifferenceLanes extends LanePanel {
  constructor(panel, differences, timeline) {
    super(panel, timeline, DIFFERENCE_PX);
    this.differences = differences;
  }

  prepare(camera) {
    const lanes = Map.groupBy(this.differences.of(camera), ({ vessel }) => vessel);
    this.layOut([...lanes].sort(([one], [other]) => one - other));
  }

  lane([vessel, list], top) {
    const { context, timeline } = this, half = (DIFFERENCE_PX - BETWEEN_PX) / 2;
    timeline.text(context, timeline.recording.facts.vessels[vessel].name, NAME_LEFT_PX, top + half, timeline.left - NAME_LEFT_PX - 6);
    context.fillStyle = colourOf('--track');
    context.fillRect(timeline.left, top, timeline.wide, 2 * half);
    for (const { index, until, outcomes: [a, b] } of list.filter((each) => timeline.shows(each.index, each.until + 1))) {
      const left = timeline.x(index), wide = Math.max(timeline.x(until + 1) - left, 1);
      context.fillStyle = colourOf(a < b ? '--run-a' : '--run-b');
      context.fillRect(left, top + (a < b ? 0 : half), wide, half);
    }
  }

  vesselAt(y) { return this.laneAt(y)?.[0] ?? null; }

  // A step and a vessel of it, if one is given, in words.
  hint(index, y) {
    const { facts } = this.timeline.recording, when = `${facts.timestamps[index]} s, step ${facts.steps[index]}`, lane = this.laneAt(y);
    if (!lane) return when;
    const [vessel, list] = lane, here = list.find((each) => each.index <= index && index <= each.until);
    return `${when}\n${facts.vessels[vessel].name}: ${here ? LETTERS.map((letter, run) => `${letter} ${OUTCOMES[here.outcomes[run]]}`).join(', ') : 'no difference'}`;
  }
}
