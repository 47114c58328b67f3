// Playing the run: one step after the other by the clock, at the chosen speed.

const SPEEDS = [0.25, 0.5, 1, 2, 5, 10, 20, 50];
const MAX_HELD_S = 1; // before what repeats begins again

class Playback {
  constructor(player) {
    Object.assign(this, { player, speed: 5, playing: false });
    for (const speed of SPEEDS) $('speed').add(new Option(`${speed}×`, speed, false, speed === this.speed));
    $('speed').addEventListener('change', () => this.setSpeed(Number($('speed').value)));
  }

  get times() { return this.player.recording.facts.times; }

  play(playing) {
    const { player } = this, paused = this.playing && !playing;
    if (playing && !player.loop.on && player.index === player.loop.whole.last) player.index = 0;
    this.playing = playing;
    $('play').textContent = playing ? '⏸ Pause' : '▶ Play';
    $('status').setAttribute('aria-live', playing ? 'off' : 'polite');
    cancelAnimationFrame(this.next);
    if (paused) player.pause();
    if (playing) this.count();
    if (playing) this.next = requestAnimationFrame((now) => this.tick(now));
  }

  // Time goes on from the shown step.
  count() {
    this.shown = this.player.index;
    this.from = { now: performance.now(), time: this.times[this.shown] };
  }

  tick(now) {
    const { player, times } = this, { loop } = player, { first, last } = loop.stretch ?? loop.whole;
    if (player.index !== this.shown) this.count(); // the user has gone there
    const time = this.from.time + ((now - this.from.now) / 1000) * this.speed;
    let index = this.shown;
    while (index < last && times[index + 1] <= time) index++;
    const again = loop.on && this.shown === last && time >= times[last] + this.held(last);
    if (again) index = first;
    if (index !== player.index) player.go(index);
    this.shown = index;
    if (again) this.count();
    if (index < last || loop.on) this.next = requestAnimationFrame((later) => this.tick(later));
    else this.play(false);
  }

  // For how much of the run's time the last frame of what repeats stays: for as long as the one before it.
  held(last) { return Math.min((this.times[last] - this.times[last - 1]) || 0, MAX_HELD_S * this.speed); }

  setSpeed(speed) {
    this.speed = speed;
    $('speed').value = speed;
    if (this.playing) this.count();
  }

  faster(by) { this.setSpeed(SPEEDS[clamped(SPEEDS.indexOf(this.speed) + by, 0, SPEEDS.length - 1)]); }
}
