// Boxes of tracks on the picture of a frame: in the colour of the vessel that the track follows, with a pale seam.

const FALSE_TRACK = '#b4bac0', SEAM = '#ffffffd0';

function trackColour(vessel, { colours }) { return vessel === null ? FALSE_TRACK : colours.vessels[vessel]; }

class TrackPicture extends Picture {
  draw(recording, index, camera, shown, frame, marked = {}) {
    super.draw(recording, index, camera, { ...shown, labels: false }, frame, { ...marked, chosen: null });
    if (shown.tracks) for (const track of recording.tracks(index, camera)) this.track(track, recording.facts);
    this.context.globalAlpha = 1;
    drawChosen(this, marked.chosen);
    if (shown.labels || shown.tracks) {
      if (!shown.labels) this.plates = this.plates.filter(({ track }) => track);
      drawPlates(this);
    }
  }

  track({ lane, vessel, box, pale }, facts) {
    const colour = trackColour(vessel, facts), wider = this.setOff({ vessel, lane });
    this.box(box, SEAM, 5 + wider);
    this.box(box, colour, 3 + wider, pale || vessel === null ? [4, 4] : []);
    this.plates.unshift({ vessel, lane, box, colour, text: `#${facts.tracks.numbers[lane]}`, below: true, track: true });
  }
}
