// Elements of the page.

const $ = (id) => document.getElementById(id);

// An element from its properties; text goes in as text, whatever it holds.
function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

function swatchOf(colour) {
  const swatch = element('span', { className: 'swatch' });
  swatch.style.background = colour;
  return swatch;
}
