// The timeline of one camera: performance state, counts of what went wrong, visible fraction of each vessel.

const MIN_STEPS = 20; // that the timeline shows
const STATE_PX = 18, BARS_PX = 20, GAP_PX = 5, AXIS_PX = 18, MAX_ROWS = 18.5, FEWER_ROWS = 12.5, NAME_LEFT_PX = 8;
const BARS = [['missed', 'missed'], ['false', 'false positives'], ['mislabelled', 'wrong class'], ['bad', 'IoU < 0.5'], ['off', 'off vessel']];

class Timeline {
  constructor(canvas, recording) {
    this.canvas = canvas;
    this.panel = canvas.closest('#timelinePanel'); // scrolls where there are many vessels
    this.context = canvas.getContext('2d');
    this.recording = recording;
    this.still = document.createElement('canvas'); // all but the playhead: drawn once a camera, size, theme or place of the panel
    this.panel.addEventListener('scroll', () => { this.paint(); this.draw(this.index, this.followed); });
  }

  // Lay out a camera's rows and draw what does not move; drawing the playhead copies it.
  prepare(recording, camera) {
    const { facts } = recording;
    if (this.to === undefined) [this.from, this.to] = [0, recording.length]; // the steps that it shows
    Object.assign(this, { recording, camera, overview: recording.overview(camera) });
    this.vessels = facts.vessels.map((_, vessel) => vessel).filter((vessel) => this.overview.everSeen(vessel));
    const width = this.panel.parentElement.clientWidth;
    this.context.font = '12px system-ui, sans-serif';
    const widest = Math.max(0, ...this.vessels.map((vessel) => this.context.measureText(facts.vessels[vessel].name).width));
    this.left = Math.min(Math.max(152, widest + NAME_LEFT_PX + 8), 0.32 * width);
    this.wide = width - this.left;
    // Misses and false positives always, the rest where there is some.
    this.kinds = BARS.filter(([kind], i) => i < 2 || this.overview[kind].some((count) => count));
    this.withClasses = this.kinds.some(([kind]) => kind === 'mislabelled');
    this.rowPx = stripHeight(this.withClasses);
    this.rowsTop = STATE_PX + this.kinds.length * (BARS_PX + GAP_PX) + 2 * GAP_PX;
    this.rowsPx = Math.min(this.vessels.length, width < NARROW_PX ? FEWER_ROWS : MAX_ROWS) * this.rowPx; // in sight
    this.height = this.rowsTop + this.rowsPx + AXIS_PX;
    const ratio = this.ratio = window.devicePixelRatio || 1;
    for (const canvas of [this.canvas, this.still]) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(this.height * ratio);
    }
    Object.assign(this.canvas.style, { width: `${width}px`, height: `${this.height}px` });
    this.panel.style.height = `${this.height}px`;
    $('timelineSpace').style.height = `${this.height - this.rowsPx + this.vessels.length * this.rowPx}px`;
    this.canvas.setAttribute('aria-valuemax', recording.length - 1);
    this.columns = this.pixelColumns();
    this.counted = new Map(); // by vessel, what became of it in each column
    this.paint();
  }

  // Draw what does not move: of the vessels those that the panel shows.
  paint() {
    const { ratio, vessels, panel: { scrollTop } } = this, context = this.still.getContext('2d');
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, this.left + this.wide, this.height);
    context.font = '12px system-ui, sans-serif';
    context.textBaseline = 'middle';
    this.states(context);
    this.kinds.forEach(([kind, name], i) => this.bars(context, STATE_PX + GAP_PX + i * (BARS_PX + GAP_PX), name, this.overview[kind]));
    context.save();
    context.beginPath();
    context.rect(0, this.rowsTop, this.left + this.wide, this.rowsPx);
    context.clip();
    const stop = Math.min(vessels.length, Math.ceil((scrollTop + this.rowsPx) / this.rowPx));
    for (let at = Math.floor(scrollTop / this.rowPx); at < stop; at++) this.strip(context, vessels[at], this.topOf(vessels[at]));
    context.restore();
    this.axis(context);
  }

  // First bin of steps and the one after the last of each column of pixels, where it is, and how many steps it has.
  pixelColumns() {
    const begin = this.overview.binOf(this.from), bins = this.overview.binOf(this.to - 1) + 1 - begin;
    const count = Math.max(1, Math.min(Math.round(this.wide), bins)), columns = [];
    const edge = (bin) => Math.round(this.x(Math.min(this.overview.firstOf(bin), this.recording.length))); // on whole pixels there are no seams
    for (let k = 0; k < count; k++) {
      const first = begin + Math.floor((k * bins) / count), stop = begin + Math.floor(((k + 1) * bins) / count), x = edge(first);
      columns.push({ first, stop, x, wide: edge(stop) - x, steps: this.overview.stopOf(stop - 1) - this.overview.firstOf(first) });
    }
    return columns;
  }

  text(context, text, x, y, most, colour = colourOf('--soft')) {
    let shown = text;
    while (shown.length > 1 && context.measureText(shown).width > most) shown = `${shown.slice(0, -2)}…`;
    context.fillStyle = colour;
    context.fillText(shown, x, y);
  }

  states(context) {
    const { facts } = this.recording;
    this.text(context, 'detector', 0, STATE_PX / 2, this.left - 6);
    for (const { index, until, state } of this.recording.states(this.camera)) {
      const x = this.x(index), wide = this.x(until + 1) - x;
      context.fillStyle = facts.colours.states[state];
      context.fillRect(x, 0, wide + 0.3, STATE_PX);
      const name = facts.states[state];
      if (context.measureText(name).width + 8 >= wide) continue;
      this.text(context, name, x + 4, STATE_PX / 2 + 1, wide, distinctFrom(context.fillStyle));
    }
  }

  // How many in each column of pixels: the mean of its frames, in parts of the greatest.
  bars(context, top, name, counts) {
    const { overview } = this, most = counts.reduce((a, b, bin) => Math.max(a, b / (overview.stopOf(bin) - overview.firstOf(bin))), 0);
    const greatest = overview.width > 1 ? most.toFixed(1) : most;
    this.text(context, most ? `${name}, max ${greatest}` : `${name}: none`, 0, top + BARS_PX / 2, this.left - 6);
    context.fillStyle = colourOf('--track');
    context.fillRect(this.left, top, this.wide, BARS_PX);
    context.fillStyle = colourOf('--alarm');
    if (most) {
      for (const { first, stop, x, wide, steps } of this.columns) {
        let sum = 0;
        for (let bin = first; bin < stop; bin++) sum += counts[bin];
        const high = (BARS_PX * sum) / steps / most;
        context.fillRect(x, top + BARS_PX - high, wide, high);
      }
    }
  }

  // A vessel's visible fraction as the strength of its colour, and what went wrong below it.
  strip(context, vessel, top) {
    const { facts } = this.recording;
    this.text(context, facts.vessels[vessel].name, NAME_LEFT_PX, top + seenTopOf(this.withClasses) + SEEN_PX / 2 + 1, this.left - NAME_LEFT_PX - 6);
    if (!this.counted.has(vessel)) { // once, not each time the panel scrolls
      const sums = (first, stop) => Object.fromEntries(COUNTED_OF_VESSELS.map((name) => [name, this.overview.sum(name, vessel, first, stop)]));
      this.counted.set(vessel, this.columns.map(({ first, stop, x }) => ({ x, ...sums(first, stop) })));
    }
    paintStrip(context, this.counted.get(vessel), this.left + this.wide, top, facts.colours.vessels[vessel], this.withClasses);
  }

  axis(context) {
    const { times } = this.recording.facts, y = this.height - AXIS_PX / 2 + 2, first = times[this.from], last = times[this.to - 1];
    const least = ((last - first) * 70) / this.wide, power = 10 ** Math.floor(Math.log10(least || 1));
    const apart = [1, 2, 5, 10].map((part) => part * power).find((step) => step >= least) ?? 1;
    context.font = '12px system-ui, sans-serif';
    for (let k = Math.ceil(first / apart); k * apart <= last; k++) {
      const time = Number((k * apart).toFixed(6)), text = `${time} s`, wide = context.measureText(text).width;
      const x = this.x(placeInTime(times, time) + 0.5);
      context.fillStyle = colourOf('--line');
      context.fillRect(x, this.height - AXIS_PX, 1, 4);
      this.text(context, text, Math.min(Math.max(x - wide / 2, this.left), this.left + this.wide - wide), y + 2, 200);
    }
  }

  // Where a step begins; at the edge for steps that are not shown.
  x(index) { return this.left + (clamped(index - this.from, 0, this.to - this.from) * this.wide) / (this.to - this.from); }

  indexAt(x) {
    const index = Math.floor(this.from + ((x - this.left) / this.wide) * (this.to - this.from));
    return clamped(index, this.from, this.to - 1);
  }

  // Whether any of some steps is shown.
  shows(first, stop = first + 1) { return first < this.to && stop > this.from; }

  // Zoom around a step, which stays where it is; 0 shows all.
  zoom(factor, index) {
    const { length } = this.recording, before = this.to - this.from;
    const span = Math.round(clamped(factor ? before / factor : length, Math.min(MIN_STEPS, length), length));
    this.look(Math.round(index - ((index - this.from) * span) / before), span);
  }

  // Move to a step that is not shown.
  keep(index) {
    const span = this.to - this.from;
    if (!this.shows(index)) this.look(index - Math.round(span / 8), span);
  }

  look(from, span) {
    this.from = clamped(from, 0, this.recording.length - span);
    this.to = this.from + span;
    this.columns = this.pixelColumns();
    this.counted = new Map();
    this.paint();
  }

  vesselAt(y) {
    if (y < this.rowsTop || y >= this.rowsTop + this.rowsPx) return null;
    return this.vessels[Math.floor((y - this.rowsTop + this.panel.scrollTop) / this.rowPx)] ?? null;
  }

  // Where a vessel's row begins, in the canvas or out of sight above or below; null if it has none.
  topOf(vessel) {
    const at = this.vessels.indexOf(vessel);
    return at < 0 ? null : this.rowsTop + at * this.rowPx - this.panel.scrollTop;
  }

  // Scroll to a vessel's row unless it is in sight.
  reveal(vessel) {
    const top = this.topOf(vessel);
    if (top === null) return;
    if (top < this.rowsTop) this.panel.scrollTop += top - this.rowsTop;
    else if (top + this.rowPx > this.rowsTop + this.rowsPx) this.panel.scrollTop += top + this.rowPx - this.rowsTop - this.rowsPx;
  }

  // A step, or the steps of its bin in a long run, and a vessel, if one is given, in words.
  say(index, vessel) {
    const { recording, overview } = this, { facts } = recording, bin = overview.binOf(index), counts = (name) => overview[name][bin];
    const state = facts.states[overview.state[bin]] ?? '–', long = overview.stopOf(bin) - overview.firstOf(bin);
    const lines = [
      long > 1 ? stepsInWords(recording, overview.firstOf(bin), overview.stopOf(bin) - 1, state) : stepInWords(recording, index, state),
      [`${counts('annotated')} annotated`, `${counts('missed')} missed`, falsePositives(counts('false')), some(counts('mislabelled'), 'of a wrong class'),
        some(counts('bad'), 'with IoU below 0.5'), some(counts('off'), 'off their vessel')].filter((word) => word).join(', '),
    ];
    if (vessel !== null) lines.push(`${facts.vessels[vessel].name}: ${vesselInBin(overview, vessel, bin).join(', ')}`);
    return lines.join('\n');
  }

  draw(index, followed) {
    if (followed !== this.followed) this.reveal(followed);
    Object.assign(this, { index, followed });
    const { context, ratio } = this, x = this.x(index + 0.5), row = this.topOf(followed);
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    if (this.still.width && this.still.height) context.drawImage(this.still, 0, 0);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    if (row !== null && row > this.rowsTop - this.rowPx && row < this.rowsTop + this.rowsPx) {
      const top = Math.max(row, this.rowsTop) - ROW_GAP_PX, bottom = Math.min(row + this.rowPx, this.rowsTop + this.rowsPx) - ROW_GAP_PX;
      context.fillStyle = colourOf('--accent');
      context.fillRect(0, top, NAME_LEFT_PX / 2, bottom - top);
      Object.assign(context, { strokeStyle: colourOf('--accent'), lineWidth: 1 });
      context.strokeRect(0.5, top + 0.5, this.left - NAME_LEFT_PX, bottom - top - 1);
    }
    drawPlayhead(context, x, this.height - AXIS_PX + 2);
    this.canvas.setAttribute('aria-valuenow', index);
    this.canvas.setAttribute('aria-valuetext', this.say(index, followed));
  }
}

// The line at the shown step, with a seam.
function drawPlayhead(context, x, high) {
  for (const [colour, wide] of [['--paper', 5], ['--ink', 2]]) {
    context.fillStyle = colourOf(colour);
    context.fillRect(x - wide / 2, 0, wide, high);
  }
}

// Where a time lies among the steps, in steps; between two where neither has it.
function placeInTime(times, time) {
  const next = times.findIndex((each) => each >= time), before = times[next - 1];
  return next < 1 ? 0 : next - (times[next] - time) / (times[next] - before);
}
