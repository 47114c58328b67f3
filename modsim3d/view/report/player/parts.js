// Parts of a recording: the frames of consecutive steps, from the page or from files beside it.

class Part {
  constructor(columns, first, stop) {
    Object.assign(this, { columns, first, stop, outlines: new Outlines(columns) });
  }
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
