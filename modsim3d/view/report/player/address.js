// What an address of the page asks for.

// The index of the first shown step that is not before the one asked for; null if none is asked for.
function indexInAddress(hash, { steps }) {
  const asked = /^#step=(\d+)$/.exec(hash);
  if (!asked) return null;
  const found = steps.findIndex((step) => step >= Number(asked[1]));
  return found < 0 ? steps.length - 1 : found;
}
