// The player: what is shown, and how mouse, keys and buttons change it.

const SPEEDS = [0.25, 0.5, 1, 2, 5, 10, 20, 50];
const CLOSEUP_ASPECT = 16 / 10, WIDEST = 2, NARROW_PX = 480, MOST_LISTED = 1000;
const $ = (id) => document.getElementById(id);

class Player {
  constructor(recording) {
    this.recording = recording;
    this.index = 0;
    this.camera = 0;
    this.speed = 5;
    this.playing = false;
    this.followed = null;
    this.shown = Object.fromEntries(LAYERS.map(([name]) => [name, name !== 'names']));
    this.drawn = { frames: 0, rows: 0, milliseconds: 0 };
    this.picture = new Picture($('picture'), NARROW_PX);
    this.closeup = new Picture($('closeup'));
    this.timeline = new Timeline($('timeline'), recording);
    this.moments = new Moments(recording);
    this.actions = {
      play: () => this.play(!this.playing), back: () => this.step(-1), forward: () => this.step(1),
      zoomIn: () => this.zoom(1.5), zoomOut: () => this.zoom(1 / 1.5), home: () => this.home(), whole: () => this.whole(),
      previous: () => this.goTo(this.moments.from(this.index, -1)), next: () => this.goTo(this.moments.from(this.index, 1)),
    };
    this.fill();
    this.listen();
    this.resize();
    this.fillKinds();
    this.home();
    if (!this.fromAddress()) this.go(Math.max(0, this.timeline.summary.seen.findIndex((seen) => seen > 0)));
  }

  // ---- what there is to choose from

  fill() {
    const { facts } = this.recording;
    $('slider').max = this.recording.length - 1;
    for (const speed of SPEEDS) $('speed').add(new Option(`${speed}×`, speed, false, speed === this.speed));
    facts.cameras.forEach(({ name }, camera) => $('camera').add(new Option(name, camera)));
    $('cameraChoice').hidden = facts.cameras.length < 2;
    LAYERS.forEach(([name, title], i) => {
      const box = element('input', { type: 'checkbox', id: `layer-${name}`, checked: this.shown[name] });
      box.addEventListener('change', () => { this.shown[name] = box.checked; this.draw(); });
      const label = element('label', {}, box, ` ${title} `, element('kbd', { textContent: `${i + 1}` }));
      $('layers').append(label);
    });
    this.rows = facts.vessels.map(({ name }, vessel) => {
      const button = element('button', { type: 'button', title: name }, swatchOf(facts.colours.vessels[vessel]), name);
      button.addEventListener('click', () => this.follow(this.followed === vessel ? null : vessel));
      const cells = ['', '', ''].map(() => element('td'));
      const row = element('tr', {}, element('td', {}, button), ...cells);
      $('vessels').append(row);
      return { row, button, cells };
    });
  }

  // The kinds of moments that the camera has.
  fillKinds() {
    const { summary } = this.timeline;
    const count = ([kind]) => this.moments.look(this.camera, kind, summary).length, kinds = KINDS.filter(count);
    $('kind').replaceChildren(...kinds.map((kind) => new Option(`${kind[1]}: ${count(kind)}`, kind[0])));
    $('momentRow').hidden = !kinds.length;
    this.lookFor(kinds.some(([kind]) => kind === this.kind) ? this.kind : (kinds[0] ?? KINDS[0])[0]);
  }

  lookFor(kind) {
    this.kind = kind;
    $('kind').value = kind;
    const list = this.moments.look(this.camera, kind, this.timeline.summary), shown = list.slice(0, MOST_LISTED);
    const options = shown.map((moment, place) => new Option(this.moments.text(moment), place));
    const more = list.length > MOST_LISTED ? ` (the first ${MOST_LISTED})` : '';
    $('moment').replaceChildren(new Option(`go to …${more}`, ''), ...options);
  }

  legend() {
    const { colours, states } = this.recording.facts, { summary } = this.timeline, parts = [];
    const add = (swatch, text) => parts.push(element('span', {}, swatch, text));
    states.forEach((name, state) => add(swatchOf(stateColour(state, states.length)), `detector: ${name}`));
    for (const [kind, text] of SYMBOLS) {
      if (!summary[kind] || summary[kind].some((count) => count)) add(symbolOf(kind, colours), text);
    }
    parts.push(element('span', { textContent:
      'Strips: a vessel’s colour while it is seen, dark while it is hidden, empty while it is out of the image; in vermilion '
      + 'below where it was missed, striped where its box was off it, lower stripes where IoU was below 0.5, above where its class was wrong.',
    }));
    $('legend').replaceChildren(...parts);
  }

  // ---- mouse, keys and buttons

  listen() {
    for (const button of document.querySelectorAll('[data-do]')) {
      button.addEventListener('click', () => this.actions[button.dataset.do]());
    }
    $('slider').addEventListener('input', () => this.go(Number($('slider').value)));
    $('speed').addEventListener('change', () => this.setSpeed(Number($('speed').value)));
    $('camera').addEventListener('change', () => this.look(Number($('camera').value)));
    $('kind').addEventListener('change', () => this.lookFor($('kind').value));
    $('moment').addEventListener('change', () => {
      if ($('moment').value) this.goTo(this.moments.choose(Number($('moment').value)));
    });
    $('theme').addEventListener('click', () => this.otherTheme());
    document.addEventListener('keydown', (event) => this.key(event));
    window.addEventListener('resize', () => this.resize());
    window.addEventListener('hashchange', () => this.fromAddress());
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.resize());
    this.listenToPicture($('picture'));
    this.listenToTimeline($('timeline'));
  }

  listenToPicture(canvas) {
    canvas.addEventListener('wheel', (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY);
    }, { passive: false });
    canvas.addEventListener('pointerdown', (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener('pointermove', (event) => {
      if (!canvas.hasPointerCapture(event.pointerId)) return;
      this.picture.view.x -= event.movementX / this.picture.scale;
      this.picture.view.y -= event.movementY / this.picture.scale;
      this.draw();
    });
    canvas.addEventListener('dblclick', () => this.home());
  }

  listenToTimeline(canvas) {
    const choose = (event) => this.go(this.timeline.indexAt(event.offsetX));
    canvas.addEventListener('pointerdown', (event) => {
      canvas.setPointerCapture(event.pointerId);
      choose(event);
      const vessel = this.timeline.vesselAt(event.offsetY);
      if (vessel !== null) this.follow(vessel);
    });
    canvas.addEventListener('pointermove', (event) => {
      if (canvas.hasPointerCapture(event.pointerId)) choose(event);
      this.hint(event.offsetX, event.offsetY);
    });
    canvas.addEventListener('pointerleave', () => { $('hint').hidden = true; });
  }

  key(event) {
    const { target, key, shiftKey } = event;
    if (event.ctrlKey || event.metaKey || event.altKey || target.matches('select')) return;
    if (key === ' ' && target.matches('button, input[type=checkbox], summary')) return;
    const keys = {
      ' ': this.actions.play, ArrowLeft: () => this.step(shiftKey ? -10 : -1), ArrowRight: () => this.step(shiftKey ? 10 : 1),
      Home: () => this.go(0), End: () => this.go(this.recording.length - 1),
      n: this.actions.next, b: this.actions.previous, '[': () => this.faster(-1), ']': () => this.faster(1),
      c: () => this.look((this.camera + 1) % this.recording.facts.cameras.length), v: () => this.followNext(),
      '+': this.actions.zoomIn, '=': this.actions.zoomIn, '-': this.actions.zoomOut,
      0: this.actions.home, 9: this.actions.whole, t: () => this.otherTheme(),
    };
    LAYERS.forEach(([name], i) => { keys[i + 1] = () => $(`layer-${name}`).click(); });
    const action = keys[key.length === 1 ? key.toLowerCase() : key];
    if (!action) return;
    event.preventDefault();
    action();
  }

  // ---- moments

  go(index) {
    this.index = Math.min(Math.max(index, 0), this.recording.length - 1);
    this.draw();
  }

  step(by) { this.play(false); this.go(this.index + by); }

  play(playing) {
    if (playing && this.index === this.recording.length - 1) this.index = 0;
    this.playing = playing;
    $('play').textContent = playing ? '⏸ Pause' : '▶ Play';
    $('status').setAttribute('aria-live', playing ? 'off' : 'polite');
    if (!playing) return;
    this.clock = { started: performance.now(), from: this.recording.facts.times[this.index] };
    requestAnimationFrame((now) => this.tick(now));
  }

  tick(now) {
    if (!this.playing) return;
    const { times } = this.recording.facts, time = this.clock.from + ((now - this.clock.started) / 1000) * this.speed;
    let index = this.index;
    while (index + 1 < times.length && times[index + 1] <= time) index++;
    if (index !== this.index) this.go(index);
    if (index === times.length - 1) this.play(false);
    else requestAnimationFrame((later) => this.tick(later));
  }

  setSpeed(speed) {
    this.speed = speed;
    $('speed').value = speed;
    if (this.playing) this.play(true);
  }

  faster(by) {
    this.setSpeed(SPEEDS[Math.min(Math.max(SPEEDS.indexOf(this.speed) + by, 0), SPEEDS.length - 1)]);
  }

  // Show a moment, with its vessel close up; all of the image if it is out of sight.
  goTo(moment) {
    if (!moment) return;
    this.play(false);
    this.followed = moment.vessel;
    this.go(moment.index);
    const found = this.recording.detections(this.index, this.camera).filter(moment.vessel === null ? (each) => each.false
      : (each) => each.vessel === moment.vessel && !each.false);
    const true_ = this.recording.truths(this.index, this.camera).filter(({ vessel }) => vessel === moment.vessel);
    const boxes = [...found.map(({ box }) => box), ...true_.map(({ full }) => full)];
    if (!boxes.every((box) => this.picture.shows(box))) this.whole();
  }

  fromAddress() {
    const asked = /^#step=(\d+)$/.exec(location.hash);
    if (!asked) return false;
    const { steps } = this.recording.facts, found = steps.findIndex((step) => step >= Number(asked[1]));
    this.go(found < 0 ? steps.length - 1 : found);
    return true;
  }

  // ---- views

  look(camera) {
    this.camera = camera;
    $('camera').value = camera;
    this.resize();
    this.fillKinds();
    this.home();
  }

  // The part of the image in which vessels are, in any frame.
  home() {
    const [width, height] = this.size, [top, bottom] = this.timeline.summary.rows, high = width / this.picture.aspect;
    const middle = top > bottom ? height / 2 : (top + bottom) / 2;
    const y = Math.min(Math.max(middle - high / 2, 0), Math.max(height - high, (height - high) / 2));
    this.picture.fit([0, y, width, y + high]);
    this.draw();
  }

  whole() { this.picture.fit([0, 0, ...this.size]); this.draw(); }

  get size() { return this.recording.facts.cameras[this.camera].size; }

  zoom(factor, x = $('picture').clientWidth / 2, y = $('picture').clientHeight / 2) {
    this.picture.zoom(factor, x, y);
    this.draw();
  }

  follow(vessel) { this.followed = vessel; this.draw(); }

  followNext() { this.follow(((this.followed ?? -1) + 1) % this.recording.facts.vessels.length); }

  otherTheme() {
    const dark = matchMedia('(prefers-color-scheme: dark)').matches, now = document.documentElement.dataset.theme;
    document.documentElement.dataset.theme = (now ?? (dark ? 'dark' : 'light')) === 'dark' ? 'light' : 'dark';
    this.resize();
  }

  // ---- drawing

  resize() {
    forgetColours();
    const [width, height] = this.size;
    this.picture.resize(Math.max(width / height, WIDEST));
    this.closeup.resize(CLOSEUP_ASPECT);
    this.timeline.prepare(this.camera);
    this.legend();
    this.draw();
  }

  draw() {
    const started = performance.now(), { recording, index, camera } = this;
    recording.rowsRead = 0;
    const frame = {
      shapes: recording.shapes(index, camera), truths: recording.truths(index, camera),
      detections: recording.detections(index, camera),
    };
    this.picture.draw(recording, index, camera, this.shown, frame);
    this.drawCloseup(frame);
    this.timeline.draw(index);
    this.say(frame);
    this.drawn = { frames: this.drawn.frames + 1, rows: recording.rowsRead, milliseconds: performance.now() - started };
  }

  // The vessel that was chosen; else the one of before, while it is there; else the nearest.
  drawCloseup(frame) {
    const { recording, index, camera } = this, wanted = this.followed ?? this.before;
    let truth = frame.truths.find(({ vessel }) => vessel === wanted);
    if (!truth && this.followed === null) truth = frame.truths.at(-1);
    this.before = truth?.vessel ?? this.before;
    const { context, canvas } = this.closeup;
    if (truth) {
      this.closeup.lookAt(truth.full, this.size);
      this.closeup.draw(recording, index, camera, this.shown, frame);
      this.picture.mark(this.closeup);
    } else {
      context.clearRect(0, 0, canvas.width, canvas.height);
      context.fillStyle = colourOf('--soft');
      context.font = '14px system-ui, sans-serif';
      const name = this.followed === null ? 'No vessel' : recording.facts.vessels[this.followed].name;
      context.fillText(`${name} is ${this.followed === null ? '' : 'not '}in the image`, 14, 26);
    }
    const name = truth ? recording.facts.vessels[truth.vessel].name : 'nothing';
    canvas.setAttribute('aria-label', `Close-up: ${name}`);
    this.rows.forEach(({ row, button }, vessel) => {
      row.classList.toggle('chosen', vessel === truth?.vessel);
      button.setAttribute('aria-pressed', vessel === this.followed);
    });
  }

  // The frame in words.
  say(frame) {
    const { facts, length } = this.recording, { index, camera } = this;
    const missed = frame.truths.filter((truth) => truth.missed).length, count = (test) => frame.detections.filter(test).length;
    const drawn = frame.detections.filter((detection) => !detection.false), wrong = frame.detections.length - drawn.length;
    $('slider').value = index;
    $('slider').setAttribute('aria-valuetext', `${facts.timestamps[index]} seconds`);
    const words = [
      `${facts.timestamps[index]} s`, `step ${facts.steps[index]} of ${facts.steps[length - 1]}`,
      this.recording.age(index, camera), `detector ${this.recording.state(index, camera)}`, `${frame.truths.length} in the image`, `${drawn.length} detected`,
      `${missed} missed`, `${wrong} false`,
      some(count(({ mislabelled }) => mislabelled), 'of a wrong class'), some(count(({ bad }) => bad), 'with IoU below 0.5'),
      some(count(({ off }) => off), 'off their vessel'),
    ].filter((word) => word).join(' · ');
    $('status').textContent = words;
    $('picture').setAttribute('aria-label', `Image of ${facts.cameras[camera].name}: ${words}`);
    const byVessel = new Map(frame.truths.map((truth) => [truth.vessel, truth]));
    const detections = new Map(drawn.map((detection) => [detection.vessel, detection]));
    const chosen = this.moments.list[this.moments.place]?.index === index ? `${this.moments.place}` : '';
    if ($('moment').value !== chosen) $('moment').value = chosen;
    this.rows.forEach(({ row, cells }, vessel) => {
      const truth = byVessel.get(vessel), carries = facts.vessels[vessel].name === facts.cameras[camera].carrier;
      const texts = truth ? describe(truth, detections.get(vessel)) : ['', '', carries ? 'carries the camera' : 'not in the image'];
      row.classList.toggle('away', !truth);
      const found = detections.get(vessel);
      row.classList.toggle('wrong', Boolean(truth?.missed || found?.mislabelled || found?.bad));
      texts.forEach((text, i) => { if (cells[i].textContent !== text) cells[i].textContent = text; });
    });
  }

  hint(x, y) {
    const { facts } = this.recording, index = this.timeline.indexAt(x), vessel = this.timeline.vesselAt(y);
    const { annotated, missed, false: wrong, mislabelled, bad, off, fraction, outcome, lost } = this.timeline.summary;
    const lines = [
      `${facts.timestamps[index]} s, step ${facts.steps[index]}: detector ${this.recording.state(index, this.camera)}`,
      [`${annotated[index]} annotated`, `${missed[index]} missed`, `${wrong[index]} false`, some(mislabelled[index], 'of a wrong class'),
        some(bad[index], 'with IoU below 0.5'), some(off[index], 'off their vessel')].filter((word) => word).join(', '),
    ];
    if (vessel !== null) {
      const at = vessel * this.recording.length + index, seen = fraction[at];
      const words = [Number.isNaN(seen) ? 'not in the image' : `${percent(seen)} visible`];
      if (lost[at]) words.push('missed');
      lines.push(`${facts.vessels[vessel].name}: ${[...words, ...wordsFor(this.recording.mistakes(outcome[at]))].join(', ')}`);
    }
    const hint = $('hint');
    hint.textContent = lines.join('\n');
    hint.hidden = false;
    hint.style.left = `${Math.max(0, Math.min(x + 12, $('timeline').clientWidth - hint.offsetWidth))}px`;
  }
}

function describe(truth, detection) {
  const seen = truth.fraction === null ? '' : percent(truth.fraction), by = truth.hider ? ` by ${truth.hider.replace(/^obstacle:/, '')}` : '';
  const as = detection?.mislabelled ? `as ${detection.label}` : 'detected', how = detection?.off ? ', off it' : detection?.bad ? ', IoU\u00a0<\u00a00.5' : '';
  const found = `${as} ${detection?.confidence.toFixed(2) ?? ''}${how}`;
  const what = truth.missed ? 'missed' : truth.detected ? found : truth.fraction === 0 ? 'hidden' : 'not annotated';
  return [`${truth.depth.toFixed(0)} m`, seen, truth.fraction === 0 ? `hidden${by}` : what];
}

// What is wrong with a detection of a vessel.
function wordsFor({ mislabelled, bad, off }) {
  return [mislabelled && 'wrong class', off ? 'off its vessel' : bad && 'IoU below 0.5'].filter((word) => word);
}

function some(count, text) { return count ? `${count} ${text}` : ''; }

// Never all or nothing where a part is seen.
function percent(fraction) {
  const rounded = Math.round(100 * fraction);
  return `${fraction > 0 && fraction < 1 ? Math.min(Math.max(rounded, 1), 99) : rounded} %`;
}

// An element from its properties; text goes in as text, whatever it holds.
function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

// The marks of the picture, by what the timeline counts of them, and what they mean.
const SYMBOLS = [
  ['truth', 'truth (dashed: the whole silhouette)'], ['detection', 'detection, in its vessel’s colour'],
  ['missed', 'missed'], ['false', 'false alarm'], ['mislabelled', 'wrong class'], ['bad', 'IoU below 0.5'],
  ['off', 'off its vessel: line to it'],
];
const BOX = '<rect x="4" y="3" width="22" height="12"';

function symbolOf(kind, { alarm, truth, sea, ink, vessels: [vessel] }) {
  const inside = {
    truth: `${BOX} stroke="${truth}"/>`,
    detection: `${BOX} stroke="${vessel}" stroke-width="2"/>`,
    missed: `<path d="M3 7V2h6M21 2h6v5M27 11v5h-6M9 16H3v-5" stroke="${alarm}" stroke-width="2"/>`,
    false: `${BOX} stroke="${alarm}" stroke-width="2" stroke-dasharray="4 2.5"/><path d="M4 3l22 12M4 15l22-12" stroke="${alarm}"/>`,
    mislabelled: `${BOX} stroke="${vessel}" stroke-width="2"/><path d="M17 2h10v10z" fill="${alarm}" stroke="${ink}"/>`,
    bad: `${BOX} stroke="${vessel}" stroke-width="2" stroke-dasharray="6 4"/>`,
    off: `<rect x="21" y="2" width="7" height="6" stroke="${truth}"/><path d="M8 12l13-6" stroke="${alarm}" stroke-width="1.5"/>`
      + `<circle cx="8" cy="12" r="3" fill="${alarm}"/>`,
  };
  const swatch = element('span', { className: 'symbol' });
  swatch.innerHTML = `<svg viewBox="0 0 30 18" fill="none" aria-hidden="true"><path d="M0 0h30v18H0z" fill="${sea}"/>${inside[kind]}</svg>`;
  return swatch;
}

function swatchOf(colour) {
  const swatch = element('span', { className: 'swatch' });
  swatch.style.background = colour;
  return swatch;
}
