// The least confidence of the detections that are shown, and what it makes of all counts and moments of the run.

class Threshold {
  constructor(player) {
    Object.assign(this, { player, least: 0, places: countPlaces(), rows: new Map() });
    $('least').addEventListener('input', () => this.set(Number($('least').value)));
  }

  set(least) {
    const { player } = this;
    $('least').value = least;
    this.least = Number($('least').value); // one that the slider has
    for (const recording of player.stage.recordings) recording.least = this.least;
    $('leastText').textContent = this.least.toFixed(2);
    player.alarm = null;
    player.draw();
    keepAddress(player);
    this.count().catch((error) => { this.rows.clear(); showFailure(error); });
  }

  // Count anew, a little at a time, until the slider is moved on; what counts read is looked up the first time.
  async count() {
    const { player, least } = this, { recordings } = player.stage, turn = this.turn = {}, goOn = () => this.turn === turn;
    if (!least) return this.show(null);
    document.body.classList.add('counting');
    const counts = [], parts = [];
    for (const recording of recordings) {
      parts.push(await this.rowsOf(recording));
      counts.push(goOn() && await countParts(recording, parts.at(-1), least, goOn));
      if (!counts.at(-1)) return;
    }
    this.show(counts, recordings.length > 1 ? countDifferences(recordings, parts) : null);
  }

  // What counts of a recording read.
  rowsOf(recording) {
    const progress = (share) => { if (this.least && share < 1) $('leastCounts').textContent = `Counting: ${percent(share)}`; };
    if (!this.rows.has(recording)) this.rows.set(recording, rowsToCount(recording, progress));
    return this.rows.get(recording);
  }

  // Show counts of the whole run, one a recording; without any those that the run has.
  show(counts, differing) {
    const { player, least } = this, { recordings } = player.stage, { every } = player.recording.facts;
    recordings.forEach((recording, i) => recording.count(counts?.[i].columns ?? recording.allColumns));
    player.differences?.use(differing?.found);
    this.tallies = counts?.map(({ tallies }) => tallies) ?? null;
    fillPlaces(this.places, this.tallies, differing);
    const shown = every > 1 ? `, in the steps that are shown: one of ${every}` : '';
    $('leastOf').textContent = counts ? `All counts are of detections with a confidence of ${least.toFixed(2)} or more${shown}.` : '';
    document.body.classList.toggle('least', Boolean(counts));
    document.body.classList.remove('counting');
    player.changeCounts();
  }

  // The active camera's counts over the whole run, in words.
  say() {
    const { recording, camera, stage } = this.player, of = this.tallies?.[stage.recordings.indexOf(recording)].camera[camera];
    $('leastCounts').textContent = of ? `All ${recording.facts.every > 1 ? 'shown ' : ''}frames of ${this.player.pane.title}: ${whole(of.detected)} detected, ${whole(of.annotated - of.detected)} missed, ${whole(of.false)} false positive${of.false === 1 ? '' : 's'}.` : '';
  }
}
