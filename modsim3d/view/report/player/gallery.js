// All mistakes that a camera sees, each as a small picture: by kind, size, visible share and range.

const THUMB = { wide: 200, high: 112, page: 48 };
const MISTAKES = ['missed', 'false', 'mislabelled', 'bad', 'off'];
// What each filter looks at, what it is called, and the edges between its ranges; the last range has no end.
const GALLERY_FILTERS = [
  { id: 'bySize', of: 'size', name: 'size', unit: ' px', edges: [0, 16, 32, 64, 128] },
  { id: 'byShare', of: 'share', name: 'visible share', unit: ' %', edges: [0, 25, 50, 75, 100] },
  { id: 'byRange', of: 'range', name: 'range', unit: ' m', edges: [0, 100, 200, 400, 800] },
];

class Gallery {
  constructor(player) {
    Object.assign(this, { player, found: [], most: THUMB.page });
    for (const { id, name, unit, edges } of GALLERY_FILTERS) {
      $(id).add(new Option(`any ${name}`, ''));
      edges.forEach((edge, i) => $(id).add(new Option(`${name} ${i + 1 < edges.length ? `${edge} to ${edges[i + 1]}` : `from ${edge}`}${unit}`, i)));
    }
    for (const id of ['byKind', ...GALLERY_FILTERS.map((each) => each.id)]) $(id).addEventListener('change', () => this.fill());
    $('moreMistakes').addEventListener('click', () => this.fill(this.most + THUMB.page));
    $('mistakes').addEventListener('toggle', () => this.open());
  }

  // Look the mistakes of the camera up, if the gallery is open.
  async open() {
    const { player } = this, { recording, camera } = player;
    if (!$('mistakes').open || (this.of?.recording === recording && this.of.camera === camera && this.of.columns === recording.columns)) return;
    const of = this.of = { recording, camera, columns: recording.columns };
    $('mistakesCount').textContent = 'looking them up …';
    const found = await mistakesIn(recording, camera);
    if (this.of !== of) return;
    this.found = found;
    const { value } = $('byKind'), kinds = MISTAKES.filter((kind) => found.some((each) => each.kind === kind));
    $('byKind').replaceChildren(new Option('all kinds', ''), ...kinds.map((kind) => new Option(kindOf(kind).name, kind)));
    if (kinds.includes(value)) $('byKind').value = value;
    await this.fill();
  }

  passes(mistake) {
    if ($('byKind').value && mistake.kind !== $('byKind').value) return false;
    return GALLERY_FILTERS.every(({ id, of, edges }) => {
      const asked = $(id).value, value = mistake[of];
      return !asked || (value !== null && value >= edges[asked] && value < (edges[Number(asked) + 1] ?? Infinity));
    });
  }

  // Show those that pass the filters, at most so many.
  async fill(most = THUMB.page) {
    const { recording, camera } = this.of, kept = this.found.filter((each) => this.passes(each)), pictures = [], turn = this.turn = {};
    for (const mistake of kept.slice(0, most)) {
      await recording.load(mistake.index);
      if (turn !== this.turn) return; // another choice was made
      pictures.push(this.picture(mistake, recording, camera));
    }
    this.most = most;
    $('thumbs').replaceChildren(...pictures);
    $('mistakesCount').textContent = `${whole(kept.length)} of ${whole(this.found.length)} in ${this.player.pane.title}`;
    $('moreMistakes').hidden = kept.length <= most;
  }

  // A button with the mistake as a picture and in words, which goes to it.
  picture(mistake, recording, camera) {
    const ratio = window.devicePixelRatio || 1, { player } = this, { timestamps, vessels, cameras } = recording.facts;
    const canvas = element('canvas', { width: THUMB.wide * ratio, height: THUMB.high * ratio }), picture = new Picture(canvas);
    picture.ratio = ratio;
    picture.lookAt(mistake.box, cameras[camera].size);
    const frame = frameOf(recording, mistake.index, camera), shown = { ...player.usual, labels: false, names: false };
    const draw = () => picture.draw(recording, mistake.index, camera, shown, frame);
    canvas.addEventListener('loaded', draw); // its picture
    draw();
    const range = mistake.range === null ? '' : inMetres(mistake.range), vessel = mistake.vessel === null ? '' : vessels[mistake.vessel].name;
    const words = [`${timestamps[mistake.index]} s`, kindOf(mistake.kind).name, vessel, range].filter((word) => word).join(' · ');
    const button = element('button', { type: 'button' }, canvas, element('span', { textContent: words }));
    button.addEventListener('click', () => {
      player.momentRow.lookFor(mistake.kind);
      player.momentRow.show(mistake);
      $('stage').scrollIntoView({ block: 'nearest' });
    });
    return button;
  }
}

// The mistakes in order of time: a picture each for frames in a row, of the first. `size` is the side of a square as large.
async function mistakesIn(recording, camera) {
  const moments = MISTAKES.flatMap((kind) => recording.moments(camera, kind).map((moment) => ({ kind, ...moment }))), found = [];
  for (const moment of moments.sort((a, b) => a.index - b.index)) {
    await recording.load(moment.index);
    const { index, vessel } = moment, truth = recording.truths(index, camera).find((each) => each.vessel === vessel);
    const box = truth?.target ?? recording.detections(index, camera).find((each) => each.false)?.box;
    if (!box) continue;
    const share = truth && truth.fraction !== null ? 100 * truth.fraction : null;
    found.push({ ...moment, box, size: Math.sqrt((box[2] - box[0]) * (box[3] - box[1])), share, range: truth?.depth ?? null });
  }
  return found;
}
