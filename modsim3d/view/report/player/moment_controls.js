// The row of controls that steps from one moment of a kind to the next.

const MAX_LISTED = 1000;

class MomentControls {
  constructor(player) {
    Object.assign(this, { player, moments: player.moments, kind: null });
    $('kind').addEventListener('change', () => this.lookFor($('kind').value));
    $('moment').addEventListener('change', () => {
      if ($('moment').value) this.show(this.moments.choose(Number($('moment').value)));
    });
  }

  count(kind) { return this.moments.count(this.player.camera, kind); }

  // The kinds of moments that the camera has.
  fill() {
    const kinds = KINDS.filter(({ kind }) => this.count(kind));
    $('kind').replaceChildren(...kinds.map(({ kind, name, key }) => new Option(`${name}: ${whole(this.count(kind))}  [${key.toUpperCase()}]`, kind)));
    $('momentRow').hidden = !kinds.length;
    if (kinds.length) this.lookFor(kinds.some(({ kind }) => kind === this.kind) ? this.kind : kinds[0].kind);
  }

  lookFor(kind) {
    const { camera } = this.player;
    this.kind = kind;
    $('kind').value = kind;
    const list = this.moments.look(camera, kind), shown = list.slice(0, MAX_LISTED);
    const options = shown.map((moment, place) => new Option(this.moments.text(moment), place));
    const more = list.length > MAX_LISTED ? ` (the first ${whole(MAX_LISTED)})` : '';
    $('moment').replaceChildren(new Option(`go to …${more}`, ''), ...options);
    for (const [button, which] of [['previous', 'Previous'], ['next', 'Next']]) {
      const text = `${which} ${kindOf(kind).one}`, [element] = document.querySelectorAll(`[data-do=${button}]`);
      element.title = `${text} (${which === 'Next' ? 'N' : 'B'})`;
      element.setAttribute('aria-label', text);
    }
  }

  // Go to the next (1) or the previous (−1) moment of a kind, or of the chosen one; say so if there is none.
  seek(by, kind = this.kind) {
    const { player } = this;
    if (!kind || !this.count(kind)) return say(kind ? `${player.pane.facts.name} has no ${kindOf(kind).one}` : 'There are no moments to look for');
    if (kind !== this.kind) this.lookFor(kind);
    const found = this.moments.from(player.index, by);
    if (found) this.show(found);
    else say(`No ${by > 0 ? 'later' : 'earlier'} ${kindOf(kind).one}`);
  }

  // Show a moment, with its vessel or its first false positive close up; all of the image if that is out of sight.
  async show(moment) {
    const { player, kind } = this, { pane, recording } = player, { index, vessel } = moment;
    player.play(false);
    player.loop.aimAt(moment, recording.facts);
    await player.go(index);
    if (kind === 'state' || player.index !== index) return; // or the user has gone on
    const { truths, detections } = player.frameOf(pane);
    const isOf = (each) => (vessel === null ? each.false : each.vessel === vessel && !each.false);
    player.choose(vessel, vessel === null ? detections.findIndex(isOf) : null);
    const boxes = [...detections.filter(isOf).map(({ box }) => box), ...truths.filter((truth) => truth.vessel === vessel).map(({ full }) => full)];
    if (!boxes.every((box) => pane.picture.shows(box))) player.whole();
  }

  // Mark in the list the moment whose first frame is shown.
  mark(index) {
    const { list, place } = this.moments, chosen = list[place]?.index === index ? `${place}` : '';
    if ($('moment').value !== chosen) $('moment').value = chosen;
  }
}
