// What the tests of the layout measure in the page: places of its parts, focus rings, contrast of texts.

const layout = (() => {
  const all = (selector) => [...document.querySelectorAll(selector)].filter((each) => each.checkVisibility());

  const meet = (a, b) => ({
    left: Math.max(a.left, b.left), top: Math.max(a.top, b.top), right: Math.min(a.right, b.right), bottom: Math.min(a.bottom, b.bottom),
  });

  const clips = (element) => element !== document.documentElement && element !== document.body
    && /auto|scroll|hidden|clip/.test(getComputedStyle(element).overflow);

  // The part of an element that those around it do not cut off.
  const seen = (element) => {
    let place = element.getBoundingClientRect();
    for (let around = element.parentElement; around; around = around.parentElement) {
      if (clips(around)) place = meet(place, around.getBoundingClientRect());
    }
    return place;
  };

  const name = (element) => element.id || element.getAttribute('aria-label') || element.textContent.trim() || element.className || element.tagName;

  const PARTS = 'button, select, input, summary, canvas, a[href], label, caption, h1, .lead, .warning, .result > div, #status, legend, '
    + '.legend > div, section h2';

  // Pairs of parts that lie over each other, unless one holds the other.
  const overlaps = () => {
    const parts = all(PARTS).map((element) => ({ element, place: seen(element) }));
    const found = [];
    parts.forEach((a, i) => parts.slice(i + 1).forEach((b) => {
      if (a.element.contains(b.element) || b.element.contains(a.element)) return;
      if (a.element.closest('thead') && b.element.closest('tbody')) return; // rows scroll under the head of their table
      const { left, top, right, bottom } = meet(a.place, b.place);
      if (right - left > 0.5 && bottom - top > 0.5) found.push(`${name(a.element)} and ${name(b.element)}`);
    }));
    return found;
  };

  // Parts that are cut off at the left or right of the window, or wider than what holds them.
  const outside = () => all(PARTS).filter((element) => {
    const { left, right } = element.getBoundingClientRect();
    return left < -0.5 || right > document.documentElement.clientWidth + 0.5;
  }).map(name);

  // What can have the focus and whose ring is cut off, or does not show.
  const badRings = () => {
    const found = [];
    for (const element of all('button, select, input, summary, canvas[tabindex], a[href], [tabindex="0"]')) {
      element.focus({ focusVisible: true, preventScroll: true });
      element.scrollIntoView({ block: 'nearest', behavior: 'instant' });
      let ringed = element; // or what is around it has the ring
      while (ringed !== document.body && getComputedStyle(ringed).outlineStyle === 'none') ringed = ringed.parentElement;
      const style = getComputedStyle(ringed), wide = parseFloat(style.outlineOffset) + parseFloat(style.outlineWidth);
      const { left, top, right, bottom } = ringed.getBoundingClientRect();
      const ring = { left: left - wide, top: top - wide, right: right + wide, bottom: bottom + wide };
      let cut = style.outlineStyle === 'none' ? 'no ring' : '';
      for (let around = ringed.parentElement; around; around = around.parentElement) {
        if (!clips(around)) continue;
        const hole = around.getBoundingClientRect();
        const over = Math.max(hole.left - ring.left, hole.top - ring.top, ring.right - hole.right, ring.bottom - hole.bottom);
        if (over > 0.5) cut = `cut by ${name(around).slice(0, 20)}`;
      }
      if (ring.left < 0 || ring.right > document.documentElement.clientWidth) cut = 'cut by the window';
      if (cut) found.push(`${name(element)}: ${cut}`);
    }
    document.activeElement.blur();
    return found;
  };

  // Red, green, blue to 255 and opacity to 1 of a computed colour.
  const channels = (colour) => {
    const [r, g, b, alpha = 1] = colour.replace('srgb', '').match(/[\d.]+/g).map(Number), unit = colour.startsWith('color(srgb') ? 255 : 1;
    return [r * unit, g * unit, b * unit, alpha];
  };

  // The colour behind what an element holds: that of what is around it shines through what is not opaque.
  const ground = (element) => {
    if (!element) return [255, 255, 255];
    const [r, g, b, alpha] = channels(getComputedStyle(element).backgroundColor);
    if (alpha === 1) return [r, g, b];
    const behind = ground(element.parentElement);
    return [r, g, b].map((value, k) => alpha * value + (1 - alpha) * behind[k]);
  };

  // The texts of the page, each with the contrast to what is behind it.
  const texts = () => {
    const found = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    for (let node = walker.nextNode(); node; node = walker.nextNode()) {
      const element = node.parentElement;
      if (!node.data.trim() || !element.checkVisibility() || /SCRIPT|STYLE|NOSCRIPT/.test(element.tagName)) continue;
      found.push([node.data.trim().slice(0, 40), channels(getComputedStyle(element).color).slice(0, 3), ground(element)]);
    }
    return found;
  };

  return { overlaps, outside, badRings, texts, seen: (selector) => { const { left, top, right, bottom } = seen(document.querySelector(selector)); return { left, top, right, bottom }; } };
})();
