// What can be taken along: a link to what is shown, the picture, and text for the clipboard.

const CAPTION_PX = 30;

// A short message that is read aloud and goes away by itself.
function say(text) {
  $('note').textContent = text;
  clearTimeout(say.timer);
  say.timer = setTimeout(() => { $('note').textContent = ''; }, 6000);
}

// To the clipboard; where the browser does not let us, into a field from which it can be copied by hand.
async function copyText(text, what) {
  try {
    await navigator.clipboard.writeText(text);
    $('byHand').hidden = true;
    say(`${what} copied`);
  } catch {
    $('byHand').hidden = false;
    $('byHandText').value = text;
    $('byHandText').focus();
    $('byHandText').select();
    say('The browser does not allow this: copy the text in the field below');
  }
}

function copyLink(player) {
  writeAddress(player);
  copyText(location.href.split('#')[0] + addressOf(player), 'Link');
}

// The picture as it is on the page, over a strip that says what it shows.
function captioned({ canvas, picture, recording, camera, run, facts: { name } }, index) {
  const { facts } = recording, ratio = picture.ratio, strip = CAPTION_PX * ratio;
  const image = element('canvas', { width: canvas.width, height: canvas.height + strip }), context = image.getContext('2d');
  context.fillStyle = colourOf('--card');
  context.fillRect(0, 0, image.width, image.height);
  context.drawImage(canvas, 0, 0);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  Object.assign(context, { font: '14px system-ui, sans-serif', textBaseline: 'middle', fillStyle: colourOf('--ink') });
  const words = [facts.name, run, name, `${facts.timestamps[index]} s`, `step ${facts.steps[index]}`, picture.narrow ? '' : `detector ${recording.state(index, camera)}`];
  context.fillText(words.filter((word) => word).join(' · '), 10, canvas.height / ratio + CAPTION_PX / 2, canvas.width / ratio - 20);
  return image;
}

// SCENE_CAMERA_STEP.png, with the run after the scene where there are two.
function pictureName({ recording: { facts }, run, facts: { name } }, index) {
  const plain = (word) => word.replace(/[^\p{L}\p{N}._-]+/gu, '-').replace(/^[-.]+|-+$/g, '') || 'unnamed';
  return `${[facts.name, run, name].filter((word) => word).map(plain).join('_')}_${facts.steps[index]}.png`;
}

async function savePicture(player) {
  await player.waiting;
  const { pane, index } = player;
  let blob;
  try {
    blob = await new Promise((done) => captioned(pane, index).toBlob(done, 'image/png'));
  } catch { // of a page on a disk: no program may read other files from it
    say('The browser does not let this page save your pictures: serve it, for instance with python -m http.server');
    return;
  }
  const link = element('a', { href: URL.createObjectURL(blob), download: pictureName(pane, index) });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  say(`Saved as ${link.download}`);
}
