// The table below the picture: every number of the truth and of the detections of one frame, to read and to copy.

const WHOLE_SILHOUETTE = 65534;
const SIDES = ['x_min_px', 'y_min_px', 'x_max_px', 'y_max_px'];

// The columns are named as in truth.parquet and detections.parquet.
const TRUTH_COLUMNS = [
  ['vessel', (row) => row.name], ['label', (row) => row.label],
  ...['full', 'visible'].flatMap((which) => SIDES.map((side, i) => [`${which}_${side}`, (row) => row[which] && fixed(row[which][i], 1)])),
  ['silhouette_px', (row) => fixed(row.silhouettePx, 1)], ['visible_px', (row) => fixed(row.visiblePx, 1)],
  ['visible_fraction', (row) => fixed(row.visibleFraction, 4)], ['in_frame_fraction', (row) => fixed(row.inFrame, 4)],
  ['depth_m', (row) => fixed(row.depth, 1)], ['occluded_by', (row) => row.hiders.map(({ name, px }) => `${name}: ${fixed(px, 1)}`).join(', ')],
  ['annotated', (row) => row.annotated], ['detected', (row) => row.detected],
];
const DETECTION_COLUMNS = [
  ['detection', ({ number }) => number], ['label', ({ label }) => label], ['confidence', ({ confidence }) => fixed(confidence, 3)],
  ...SIDES.map((side, i) => [side, ({ box }) => fixed(box[i], 1)]),
  ['state', ({ state }) => state], ['kind', ({ kind }) => kind], ['vessel', ({ name }) => name], ['iou', ({ iou }) => iou], ['outcome', (row) => row.outcome],
];

// Nothing for what is not known.
function fixed(value, digits) { return value === null || Number.isNaN(value) ? null : value.toFixed(digits); }

function truthRows(recording, frame) {
  return frame.truths.toReversed().map((truth) => {
    const numbers = recording.numbers(frame.index, truth.row), { silhouettePx, hiddenPx } = numbers;
    const visiblePx = silhouettePx - hiddenPx, visibleFraction = silhouettePx > 0 ? visiblePx / silhouettePx : null;
    return { ...recording.facts.vessels[truth.vessel], ...truth, ...numbers, visiblePx, visibleFraction };
  });
}

function detectionRows(recording, frame) {
  const state = recording.state(frame.index, frame.camera);
  return frame.detections.map((each) => {
    const truth = each.false ? null : frame.truths.find(({ vessel }) => vessel === each.vessel);
    const outcome = each.false ? 'false positive' : wordsFor(each).join(', ') || 'right';
    return { ...each, state, outcome, name: each.vessel === null ? null : recording.facts.vessels[each.vessel].name, iou: truth && iouInWords(each, truth) };
  });
}

function cellText(value) { return value === null || value === undefined ? '' : `${value}`; }

// Tab-separated, as spreadsheets take it; a tab or a line break in a name would be another cell.
function separated(columns, rows) {
  const clean = (value) => cellText(value).replace(/[\t\r\n]+/g, ' ');
  return [columns.map(([name]) => name), ...rows.map((row) => columns.map(([, value]) => clean(value(row))))].map((line) => line.join('\t')).join('\n');
}

class Numbers {
  constructor(player) {
    this.player = player;
    this.panel = $('numbers');
    this.panel.addEventListener('toggle', () => this.open());
    $('numbersCopy').addEventListener('click', () => this.copy());
  }

  // While the run plays, the tables stay those of the frame at which it began to, or at which they were opened.
  show(frame) {
    if (this.panel.open && !this.player.playing) this.fillAll(frame);
  }

  open() {
    const frame = this.player.frameOf(this.player.pane);
    if (!this.panel.open || !frame) return;
    this.fillAll(frame);
    this.panel.scrollIntoView({ block: 'nearest' });
  }

  fillAll(frame) {
    const { player } = this;
    const { recording, title } = player.pane, { timestamps, steps } = recording.facts;
    this.index = frame.index;
    this.truths = truthRows(recording, frame);
    this.detections = detectionRows(recording, frame);
    $('numbersOf').textContent = [`${title}, ${timestamps[frame.index]} s, step ${steps[frame.index]}`, recording.age(frame.index, frame.camera)].filter((word) => word).join(', ');
    this.fill($('numbersTruth'), TRUTH_COLUMNS, this.truths);
    this.fill($('numbersDetections'), DETECTION_COLUMNS, this.detections);
    this.mark();
  }

  // The browser tells of it later, once, as after a click: filled here too, the tables would be filled again by then
  // with another frame.
  toggle() {
    this.panel.open = !this.panel.open;
  }

  fill(table, columns, rows) {
    const cells = (row) => columns.map(([, value]) => {
      const text = cellText(value(row));
      return element('td', { textContent: text, className: /^[\d.]+$/.test(text) ? 'number' : '' });
    });
    const head = element('tr', {}, ...columns.map(([name]) => element('th', { scope: 'col', textContent: name })));
    table.tHead.replaceChildren(head);
    table.tBodies[0].replaceChildren(...rows.map((row, i) => {
      const line = element('tr', {}, ...cells(row));
      line.addEventListener('click', () => { // not where text was marked
        if (!getSelection().isCollapsed) return;
        this.player.choose(row.false ? null : row.vessel, row.false && this.index === this.player.index ? i : null);
      });
      return line;
    }));
  }

  // The rows of what is chosen.
  mark() {
    const { followed, alarm } = this.player, rows = (id) => [...$(id).tBodies[0].rows];
    rows('numbersTruth').forEach((row, i) => row.classList.toggle('chosen', this.truths[i].vessel === followed));
    rows('numbersDetections').forEach((row, i) => {
      const { vessel, false: wrong } = this.detections[i];
      row.classList.toggle('chosen', wrong ? alarm === i : vessel === followed);
    });
  }

  copy() {
    copyText(`${$('numbersOf').textContent}\n\n${separated(TRUTH_COLUMNS, this.truths)}\n\n${separated(DETECTION_COLUMNS, this.detections)}\n`, 'Numbers');
  }
}
