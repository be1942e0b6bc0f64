// Poses of many recorded ticks at once, so that going through them needs no server.

const COUNT = 256;
const BEFORE = 32;
const MAX_TRACKS = 24;

export class Tracks {
  // ask(first, count) → promise of a track, or of null
  constructor(ask) {
    this.ask = ask;
    this.clear();
  }

  clear() {
    this.tracks = [];
    this.pending = null;
    this.age = (this.age ?? 0) + 1;
  }

  // Ticks were dropped before the first one.
  shift(count) {
    for (const track of this.tracks) track.first -= count;
    this.tracks = this.tracks.filter((each) => each.first >= 0);
  }

  at(index) {
    const place = this.tracks.findIndex((each) => index >= each.first && index < each.first + each.count);
    if (place < 0) return null;
    const [track] = this.tracks.splice(place, 1);
    this.tracks.push(track);
    return track;
  }

  // Returns the track with an index, when it is there; null if the server has to show that tick.
  async load(index, backwards) {
    if (this.pending) return this.pending;
    const { age } = this;
    const first = Math.max(0, index - (backwards ? COUNT - BEFORE : BEFORE));
    this.pending = this.ask(first, COUNT)
      .then((track) => {
        if (age !== this.age) return null;
        this.tracks.push(track ?? { first, count: COUNT, isRemote: true });
        while (this.tracks.length > MAX_TRACKS) this.tracks.shift();
        return track;
      })
      .catch(() => null)
      .finally(() => {
        if (age === this.age) this.pending = null;
      });
    return this.pending;
  }
}
