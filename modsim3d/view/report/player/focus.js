// Keys that mean something only to the part of the page that has the focus; keys.js has those of the whole page.

const SHIFT_PART = 0.1;

// Do something for each of some keys, in place of what the page does at them.
function onKeys(place, keys, needsShift = false) {
  place.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.shiftKey !== needsShift || !keys[event.key]) return;
    event.preventDefault();
    event.stopPropagation();
    keys[event.key](event);
  });
}

// With shift the arrow keys move the image, as dragging it does.
function listenOnPicture(pane, player) {
  const { canvas } = pane, by = (across, down) => () => {
    pane.move(-across * SHIFT_PART * canvas.clientWidth, -down * SHIFT_PART * canvas.clientHeight);
    player.draw();
  };
  onKeys(canvas, { ArrowLeft: by(-1, 0), ArrowRight: by(1, 0), ArrowUp: by(0, -1), ArrowDown: by(0, 1) }, true);
}

// Up and down go from a vessel's strip to the next; what the pointer would say of it stands at the playhead.
function listenOnTimeline(timeline, player, hint) {
  const { canvas } = timeline, next = (by) => () => {
    const { vessels } = timeline, at = vessels.indexOf(player.followed);
    if (vessels.length) player.choose(vessels[at < 0 ? (by > 0 ? 0 : vessels.length - 1) : clamped(at + by, 0, vessels.length - 1)]);
  };
  onKeys(canvas, { ArrowUp: next(-1), ArrowDown: next(1), Escape: () => { hint.hidden = true; } });
  canvas.addEventListener('keyup', ({ key }) => {
    if (key === 'Escape') return;
    const { left, top } = canvas.getBoundingClientRect(), row = timeline.topOf(player.followed);
    const y = row === null ? timeline.rowsTop : row + timeline.rowPx;
    showHint(hint, left + timeline.x(player.index + 0.5), top + y, timeline.say(player.index, player.followed));
  });
  canvas.addEventListener('blur', () => { hint.hidden = true; });
}

// One stop of the Tab key for all buttons of a list; up and down go from one to the next.
function rove(list) {
  const buttons = () => [...list.querySelectorAll('button')].filter((button) => button.offsetParent);
  const stop = (chosen) => { for (const button of list.querySelectorAll('button')) button.tabIndex = button === chosen ? 0 : -1; };
  const next = (by) => () => {
    const all = buttons();
    all[clamped(all.indexOf(document.activeElement) + by, 0, all.length - 1)]?.focus();
  };
  list.addEventListener('focusin', ({ target }) => stop(target));
  onKeys(list, { ArrowUp: next(-1), ArrowDown: next(1) });
}
