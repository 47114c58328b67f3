// How far a view of an image may zoom and move: from the whole image to a twentieth of it, and little beyond its edges.

const MAX_ZOOM = 20, MARGIN = 0.1;

function clamped(value, least, most) { return Math.min(Math.max(value, least), most); }

// A width in image pixels that a view may have.
function widthWithin(wanted, aspect, [width, height]) {
  const whole = Math.max(width, height * aspect);
  return clamped(wanted, whole / MAX_ZOOM, whole);
}

// The nearest view that stays with the image.
function viewWithin({ x, y, width }, aspect, size) {
  const wide = widthWithin(width, aspect, size);
  const within = (at, span, limit) => {
    const margin = MARGIN * Math.min(span, limit);
    return clamped(at, Math.min(0, limit - span) - margin, Math.max(0, limit - span) + margin);
  };
  return { x: within(x, wide, size[0]), y: within(y, wide / aspect, size[1]), width: wide };
}
