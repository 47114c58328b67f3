// The player: what is shown, and how controls change it. Each part of the page has a file of its own.

class Player {
  // Of one run, or of two with their differences.
  constructor(recordings, differences = null) {
    this.index = 0;
    this.followed = null; // the vessel that is chosen, and
    this.alarm = null; // the false positive that is: its place among the detections of the frame
    this.differences = differences;
    this.stage = new Stage(this, recordings, differences ? differences.runs : ['']);
    const { recording } = this, { facts } = recording;
    this.loop = new Loop(recording.length);
    this.playback = new Playback(this);
    this.shown = Object.fromEntries(LAYERS.map(([name]) => [name, name !== 'names']));
    this.drawn = { frames: 0, rows: 0, milliseconds: 0 };
    this.closeup = new Closeup($('closeup'));
    this.above = new Above($('above'), (vessel) => this.choose(vessel));
    this.timeline = new Timeline($('timeline'), recording);
    this.lanes = facts.tracks ? new Lanes($('lanesPanel'), recording, this.timeline) : null;
    this.differenceLanes = differences && new DifferenceLanes($('differencesPanel'), differences, this.timeline);
    this.moments = new Moments(recording, differences);
    this.momentRow = new MomentControls(this);
    this.list = new VesselList($('vessels'), facts, (vessel) => this.choose(this.followed === vessel ? null : vessel));
    this.numbers = new Numbers(this);
    this.threshold = new Threshold(this);
    this.gallery = new Gallery(this);
    this.actions = {
      play: () => this.play(!this.playing), back: () => this.step(-1), forward: () => this.step(1),
      zoomIn: () => this.zoom(1.5), zoomOut: () => this.zoom(1 / 1.5), home: () => this.home(), whole: () => this.whole(),
      previous: () => this.momentRow.seek(-1), next: () => this.momentRow.seek(1), loop: () => this.repeat(),
      timeIn: () => this.zoomTime(2), timeOut: () => this.zoomTime(0.5), timeWhole: () => this.zoomTime(0),
      link: () => copyLink(this), save: () => savePicture(this), keys: () => this.keyHelp.toggle(),
    };
    this.fill();
    this.usual = { ...this.shown };
    this.listen();
    this.resize();
    this.momentRow.fill();
    this.home();
    if (!this.fromAddress()) this.goToFirst();
    clearTimeout(writeAddress.timer); // the address stays as it is until something is done
  }

  get playing() { return this.playback.playing; }
  get panes() { return this.stage.panes; }
  get pane() { return this.stage.active; }
  get recording() { return this.pane.recording; }
  get camera() { return this.pane.camera; }
  get picture() { return this.pane.picture; }

  // ---- what there is to choose from

  fill() {
    const { facts } = this.recording;
    $('slider').max = this.recording.length - 1;
    LAYERS.forEach(([name, title], i) => this.addLayer(name, title, i + 1));
    if (this.lanes) {
      this.shown.tracks = true;
      this.addLayer('tracks', 'Tracks', 'K');
    }
    if (hasPlaces(facts)) PLAN_LAYERS.forEach((layer) => this.addLayer(...layer));
  }

  addLayer(name, text, key, title = '') {
    const box = element('input', { type: 'checkbox', id: `layer-${name}`, title, checked: (this.shown[name] ??= false) });
    box.addEventListener('change', () => {
      this.shown[name] = box.checked;
      if (box.checked && RINGS[name]) this.show(Object.fromEntries(PLAN_LAYERS.map(([each]) => [each, each === name])));
      this.draw();
      keepAddress(this);
    });
    $('layers').append(element('label', { title }, box, ` ${text} `, element('kbd', { textContent: `${key}` })));
  }

  listen() {
    for (const button of document.querySelectorAll('.transport [data-do], .time [data-do]')) {
      button.addEventListener('click', () => this.actions[button.dataset.do]());
    }
    $('slider').addEventListener('input', () => this.go(Number($('slider').value)));
    $('theme').addEventListener('click', () => this.otherTheme());
    window.addEventListener('resize', () => this.resize());
    window.addEventListener('hashchange', () => this.fromAddress());
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.resize());
    this.keyHelp = new KeyHelp(listenToKeys(this));
    rove($('vessels'));
    const { timeline, lanes } = this;
    listenOnTimeline(timeline, this, $('hint'));
    timeline.canvas.addEventListener('wheel', (event) => {
      if (!event.ctrlKey && !event.metaKey) return;
      event.preventDefault();
      this.zoomTime(Math.exp(-event.deltaY / 400), timeline.indexAt(event.offsetX));
    }, { passive: false });
    const hint = { element: $('hint'), text: (x, y) => timeline.say(timeline.indexAt(x), timeline.vesselAt(y)) };
    listenToTime(timeline.canvas, this, (y) => timeline.vesselAt(y), hint);
    const { differenceLanes } = this;
    if (differenceLanes) {
      const hint = { element: $('differenceHint'), text: (x, y) => differenceLanes.hint(timeline.indexAt(x), y) };
      listenToTime(differenceLanes.canvas, this, (y) => differenceLanes.vesselAt(y), hint);
    }
    if (!lanes) return;
    const laneHint = { element: $('laneHint'), text: (x, y) => lanes.hint(timeline.indexAt(x), lanes.laneAt(y), this.camera) };
    listenToTime(lanes.canvas, this, (y) => lanes.vesselOf(lanes.laneAt(y), this.index), laneHint);
  }

  // ---- steps and moments

  // Show a step: at once if it is ready, or as soon as it is. Returns when it is shown.
  go(index) {
    const before = this.index;
    this.index = Math.min(Math.max(index, 0), this.recording.length - 1);
    if (this.index !== before) this.alarm = null;
    this.loop.leave(this.index);
    this.draw();
    this.lanes?.reveal(this.index);
    keepAddress(this);
    return this.waiting;
  }

  // The first step with a vessel in the image, through a camera that sees one.
  goToFirst() {
    const { recording, camera } = this, first = (of) => recording.overview(of).seen.findIndex((seen) => seen > 0);
    const other = first(camera) < 0 ? recording.facts.cameras.findIndex((_, each) => first(each) >= 0) : -1;
    if (other >= 0) this.look(other);
    this.go(recording.overview(this.camera).firstOf(Math.max(0, first(this.camera))));
  }

  step(by) { this.play(false); this.go(this.index + by); }

  play(playing) { this.playback.play(playing); }

  // What waits while the run plays: the order of the list, the numbers, the address.
  pause() { this.draw(); keepAddress(this); }

  repeat() {
    this.loop.toggle();
    this.draw();
  }

  fromAddress() {
    const { hash } = location, { facts } = this.recording, asked = partsOf(hash);
    const camera = placeOf(asked.get('camera'), facts.cameras), vessel = placeOf(asked.get('vessel'), facts.vessels);
    const index = indexInAddress(hash, facts), layers = layersInAddress(hash, this.shown);
    if (camera !== null && camera !== this.stage.panes[0].camera) {
      this.stage.activate(this.stage.panes[0]);
      this.look(camera);
    }
    const whole = index !== null; // an address with a step says all: what it leaves out is as usual
    if (whole || asked.has('beside')) this.stage.beside(asked.get('beside') ?? '');
    if (whole || layers) this.show(layers ?? this.usual);
    if (whole || asked.has('confidence')) this.threshold.set(Math.min(Number(asked.get('confidence')) || 0, 1));
    if (whole) this.go(index);
    if (whole || vessel !== null) this.choose(vessel);
    return whole;
  }

  // ---- views

  look(camera) {
    this.stage.look(camera);
    this.changePane();
    this.home();
    keepAddress(this);
  }

  // Another pane is the active one, or another camera is in it.
  changePane() {
    this.alarm = null;
    this.moments.recording = this.recording;
    this.changeCounts();
  }

  // Other counts and moments of the whole run are to be shown.
  changeCounts() {
    this.resize();
    this.momentRow.fill();
    this.gallery.open();
    this.threshold.say();
  }

  home() { this.stage.home(); this.draw(); }

  whole() { this.pane.whole(); this.draw(); }

  // Zoom the timeline around a step; 0 shows the whole run.
  zoomTime(factor, index = this.index) {
    this.timeline.zoom(factor, index);
    this.draw();
  }

  zoom(factor) { this.pane.zoom(factor); this.draw(); }

  // A vessel, or a false positive of this frame, or nothing.
  choose(vessel, alarm = null) {
    Object.assign(this, { followed: vessel, alarm });
    this.draw();
    if (vessel !== null) this.list.reveal(vessel);
    keepAddress(this);
  }

  followNext(by = 1) {
    const { length } = this.recording.facts.vessels, from = this.followed ?? (by > 0 ? -1 : length);
    this.choose((from + by + length) % length);
  }

  show(layers) {
    Object.assign(this.shown, layers);
    for (const name of Object.keys(layers)) $(`layer-${name}`).checked = layers[name];
    this.draw();
  }

  otherTheme() {
    const dark = matchMedia('(prefers-color-scheme: dark)').matches, now = document.documentElement.dataset.theme;
    document.documentElement.dataset.theme = (now ?? (dark ? 'dark' : 'light')) === 'dark' ? 'light' : 'dark';
    this.resize();
  }

  // ---- drawing

  resize() {
    forgetColours();
    this.stage.resize();
    this.closeup.resize(this.pane);
    this.above.resize();
    this.timeline.prepare(this.recording, this.camera);
    this.lanes?.prepare(this.camera);
    this.differenceLanes?.prepare(this.camera);
    $('legend').replaceChildren(...legendOf(this.recording, this.timeline.overview));
    this.draw();
  }

  // What a step needs of each recording is made ready first.
  draw() {
    const { index } = this, recordings = new Set(this.panes.map((pane) => pane.recording));
    if (![...recordings].every((recording) => recording.ready(index))) {
      this.waiting ??= this.makeReady(recordings);
      return;
    }
    this.waiting = null;
    $('failure').hidden = true; // of a part that is not wanted any more
    this.drawFrame();
    for (const recording of recordings) recording.prefetch(index);
  }

  async makeReady(recordings) {
    try {
      for (let index = -1; index !== this.index;) { // until the step is still the wanted one when it is ready
        index = this.index;
        await Promise.all([...recordings].map((recording) => recording.load(index)));
      }
      this.draw();
    } catch (error) {
      this.waiting = null;
      showFailure(error);
    }
  }

  drawFrame() {
    const started = performance.now(), { recording, index, pane, stage } = this;
    recording.rowsRead = 0;
    const frame = stage.draw(index, this), close = this.closeup.draw(pane, frame, this.followed, this.shown, this.alarm, this.playing);
    this.above.draw(recording, [pane, ...this.panes].map((each) => each.camera), index, this.followed, this.shown);
    this.list.show(frame, pane.facts.carrier, this.playing, stage.otherFrame);
    this.list.mark(close.vessel, this.followed);
    this.numbers.show(frame);
    this.timeline.keep(index);
    this.timeline.draw(index, this.followed);
    markStretch(this.timeline, this.loop.marked);
    this.lanes?.draw(index);
    this.differenceLanes?.draw(index);
    this.say(frame, close);
    this.drawn = { frames: this.drawn.frames + 1, rows: recording.rowsRead, milliseconds: performance.now() - started };
  }

  frameOf(pane) { return this.stage.frameOf(pane); }

  // The frame, and what is close up, in words.
  say(frame, { vessel, alarm }) {
    const { facts } = this.recording, words = [this.pane.run, frameInWords(this.recording, frame)].filter((word) => word).join(': ');
    $('slider').value = this.index;
    $('slider').setAttribute('aria-valuetext', `${facts.timestamps[this.index]} seconds`);
    $('status').textContent = words;
    this.pane.canvas.setAttribute('aria-label', `Image of ${this.pane.facts.name}: ${words}`);
    const close = alarm !== null ? alarmInWords(frame.detections[alarm], facts) : vessel === null ? [] : vesselInWords(vessel, frame, facts);
    $('chosen').textContent = $('chosen').title = close.join(' · ');
    this.momentRow.mark(this.index);
  }
}
