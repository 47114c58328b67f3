// Parts of a recording: the frames of consecutive steps, from the page or from files beside it.

class Part {
  constructor(columns, first, stop) {
    Object.assign(this, { columns, first, stop, outlines: new Outlines(columns) });
  }
}

// The row of the detection of each row of the truth, −1 for none. A vessel that is detected without a box of its own is the other one
// in a box of two: the one that covers it most.
function detectionsIn(part, { kinds, outcomes: { FALSE_POSITIVE } }) {
  if (part.found) return part.found;
  const { truthStart, vessel, flags, full, drawnStart, drawnVessel, outcome, kind, box } = part.columns, merged = kinds.indexOf('merged');
  const found = part.found = new Int32Array(vessel.length).fill(-1), own = new Map();
  const side = (row, drawn, a) => Math.max(0, Math.min(full[4 * row + a + 2], box[4 * drawn + a + 2]) - Math.max(full[4 * row + a], box[4 * drawn + a]));
  for (let frame = 0; frame + 1 < truthStart.length; frame++) {
    const ofTwo = [];
    own.clear();
    for (let drawn = drawnStart[frame]; drawn < drawnStart[frame + 1]; drawn++) {
      if (outcome[drawn] & FALSE_POSITIVE) continue;
      own.set(drawnVessel[drawn], drawn);
      if (kind[drawn] === merged) ofTwo.push(drawn);
    }
    for (let row = truthStart[frame]; row < truthStart[frame + 1]; row++) {
      found[row] = own.get(vessel[row]) ?? -1;
      if (found[row] >= 0 || !(flags[row] & 2) || !ofTwo.length) continue;
      const covered = ofTwo.map((drawn) => side(row, drawn, 0) * side(row, drawn, 1));
      [found[row]] = ofTwo.splice(covered.indexOf(Math.max(...covered)), 1);
    }
  }
  return found;
}

class Outlines {
  constructor({ lineCount, cornerCount, corners }) {
    Object.assign(this, { corners, lineStart: beginnings(lineCount), cornerStart: beginnings(cornerCount) });
  }

  lines(outline, quantum) {
    const lines = [];
    for (let line = this.lineStart[outline]; line < this.lineStart[outline + 1]; line++) {
      const part = this.corners.subarray(2 * this.cornerStart[line], 2 * this.cornerStart[line + 1]);
      lines.push(Array.from(part, (value) => value * quantum));
    }
    return lines;
  }
}

// The packed text of a part: in the page, or in a file beside it, which is a script because a page from a disk can read no other.
function textOfPart(folder, name, number) {
  const id = `part-${name}-${number}`;
  if (!folder) return $(id).textContent;
  return new Promise((resolve, reject) => {
    const script = element('script', { src: `${folder}/${name}-${number}.js` });
    takers.set(id, resolve);
    // After `takePart` a rejection means nothing: what is loaded without calling it is damaged.
    for (const kind of ['load', 'error']) {
      script.addEventListener(kind, () => {
        script.remove();
        takers.delete(id);
        reject(new Error(`${folder}/${name}-${number}.js cannot be read: copy the whole folder with the page.`));
      });
    }
    document.head.append(script);
  });
}

const takers = new Map();
window.takePart = (id, text) => takers.get(id)?.(text);
