/** What both views share: the anchors of the last response, the one in focus, and the figures. */

import { pick, showLegend } from "./drawing.js";
import { clearFigures, columnsOf, fadeFigures, nameAnchor, showBest, showTimes } from "./figures.js";

export class AnchorView {
  /** Whether this is the view on the page. */
  active = false;
  /** The anchor that was clicked, or null. */
  kept = null;

  /** Subclasses have `card`, `summarize(anchors)` and `showDetails(anchors, n, step)`; `path` are columns. */
  constructor(surface, legend, path) {
    Object.assign(this, { surface, legend, path });
    surface.onTheme = () => this.showAnchors();
  }

  /** Show new anchors; returns whether their bundle is still chosen when they are on the screen. */
  async present(anchors, { card, sentAt, stale = false, ...more }) {
    if (this.kept >= anchors.count) this.kept = null;
    Object.assign(this.surface.show, { anchors, stale, focus: this.kept, step: null, ...more });
    fadeFigures(stale);
    this.showAnchors();
    const shownAt = await this.surface.draw();
    const isCurrent = this.active && card === this.card;
    if (isCurrent) showTimes(anchors.timing, shownAt - sentAt);
    return isCurrent;
  }

  /** Update all figures of the anchors on the screen. */
  showAnchors() {
    const { anchors, focus, step, stale, colourBy } = this.surface.show;
    if (!anchors || !this.active) return;
    if (!stale) this.summarize(anchors);
    const n = focus ?? anchors.best;
    nameAnchor(anchors, focus);
    this.showDetails(anchors, n, step);
    showLegend(this.legend, anchors, colourBy);
    showBest(this.surface, anchors, {
      columns: columnsOf(anchors, this.path),
      focus: n,
      onLook: (row) => this.look(row),
      onKeep: (row) => this.keep(row),
    });
  }

  /** Bring anchor n into focus; null: the one that was clicked, or the best. */
  look(n, step = null) {
    const { show } = this.surface;
    const focus = n ?? this.kept;
    if (show.focus === focus && show.step === step) return;
    Object.assign(show, { focus, step });
    this.showAnchors();
    this.surface.draw();
  }

  /** Bring the anchor under the pointer into focus; null: no pointer. */
  hover(left, top) {
    const found = left === null ? null : this.under(left, top);
    this.look(found?.anchor ?? null, found?.step);
  }

  under(left, top) {
    const { anchors } = this.surface.show;
    return anchors && pick(this.surface, anchors, left, top);
  }

  /** A click keeps an anchor in focus, or lets it go. */
  keep(n) {
    this.kept = this.kept === n ? null : n;
    this.look(this.kept);
  }

  /** The anchors on the screen are older than what is asked now. */
  fade() {
    this.surface.show.stale = true;
    fadeFigures(true);
    this.surface.draw();
  }

  /** Forget the response of the bundle before. */
  clear() {
    this.kept = null;
    Object.assign(this.surface.show, { anchors: null, stale: false, focus: null, step: null });
    clearFigures();
    showLegend(this.legend, null);
    this.surface.draw();
  }
}
