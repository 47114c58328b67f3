// A hint beside the pointer, inside the window: below it and to the right, or on the other side where there is no room.

const HINT_PX = 14;

// `x` and `y` are places in the window.
function showHint(hint, x, y, text) {
  hint.textContent = text;
  hint.hidden = false;
  const { offsetWidth: wide, offsetHeight: high } = hint, { clientWidth, clientHeight } = document.documentElement;
  const beside = (at, span, limit) => (at + HINT_PX + span <= limit ? at + HINT_PX : Math.max(at - HINT_PX - span, 0));
  hint.style.left = `${Math.min(beside(x, wide, clientWidth), Math.max(clientWidth - wide, 0))}px`;
  hint.style.top = `${Math.min(beside(y, high, clientHeight), Math.max(clientHeight - high, 0))}px`;
}
