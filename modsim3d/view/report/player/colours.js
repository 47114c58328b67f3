// Colours of the theme, and what may be done with them.

let resolved = new Map();

// The colour of a CSS variable in the theme of the moment.
function colourOf(variable) {
  if (!resolved.has(variable)) {
    const probe = document.createElement('span');
    probe.style.color = `var(${variable})`;
    document.body.append(probe);
    resolved.set(variable, getComputedStyle(probe).color);
    probe.remove();
  }
  return resolved.get(variable);
}

function forgetColours() { resolved = new Map(); }

// Red, green and blue of a colour as the browser or the recording writes it.
function channels(colour) {
  if (colour.startsWith('#')) return [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  return colour.match(/[\d.]+/g).slice(0, 3).map(Number);
}

function mixed(from, to, part) { return `rgb(${from.map((value, i) => Math.round(value + part * (to[i] - value)))})`; }

// Black or white, whichever stands out more from a colour: by 4.58 at least.
function distinctFrom(colour) { return contrast('#000000', colour) >= contrast('#ffffff', colour) ? '#000000' : '#ffffff'; }

// The contrast of two colours, 1 to 21, as the Web Content Accessibility Guidelines define it.
function contrast(a, b) {
  const [low, high] = [luminance(a), luminance(b)].sort((x, y) => x - y);
  return (high + 0.05) / (low + 0.05);
}

function luminance(colour) {
  const [red, green, blue] = channels(colour).map((value) => (value <= 10.31 ? value / 3294.6 : ((value / 255 + 0.055) / 1.055) ** 2.4));
  return 0.2126 * red + 0.7152 * green + 0.0722 * blue;
}
