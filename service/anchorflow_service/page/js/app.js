/** Puts the page together: whichever bundle is chosen, the view of its kind asks and shows. */

import { Amount } from "./amount.js";
import { CardPanel } from "./card.js";
import { Connection } from "./connection.js";
import { byId } from "./dom.js";
import { MapView } from "./map/view.js";
import { Models } from "./models.js";
import { say } from "./panels.js";
import { Planner } from "./planner.js";
import { TensorView } from "./tensors/view.js";

/** By the conditioning of a card; a kind that is not known is asked with what its card lists. */
const VIEWS = { cost_map: MapView, tensors: TensorView };
const FIRST_WAIT_MS = 250;
const LONGEST_WAIT_MS = 4000;

/**
 * A view says {kind}, what it asks, `question()`, and takes
 *   useCard(card)     it is chosen; it asks at once
 *   leave()           another one is
 *   choose(options)   of `Amount`
 *   answered({question, answer, sentAt}), refused({question, error}), down()
 */
class App {
  #views = {};
  /** null until a bundle is known. */
  view = null;

  constructor() {
    this.models = new Models();
    this.planner = new Planner(() => ({ ...this.view?.question(), view: this.view }));
    this.connection = new Connection(this.planner);
    this.amount = new Amount((options, time) => this.view.choose(options, time));
    this.card = new CardPanel();
    byId("ask").addEventListener("submit", (event) => event.preventDefault());
    this.models.addEventListener("choose", (event) => this.#use(event.detail));
    this.planner.addEventListener("answer", (event) => this.#take("answered", event.detail));
    this.planner.addEventListener("refusal", (event) => this.#take("refused", event.detail));
    this.planner.addEventListener("down", () => this.view?.down());
    this.planner.addEventListener("up", () => this.#refresh());
  }

  /** The page needs the cards before it can ask; it waits for a service that is still starting. */
  async begin() {
    for (let wait = FIRST_WAIT_MS; ; wait = Math.min(2 * wait, LONGEST_WAIT_MS)) {
      try {
        await this.models.refresh();
        return;
      } catch (error) {
        this.connection.wait(error.message);
        await new Promise((resolve) => setTimeout(resolve, wait));
      }
    }
  }

  #use(card) {
    const kind = card.conditioning.kind in VIEWS ? card.conditioning.kind : "tensors";
    const view = (this.#views[kind] ??= new VIEWS[kind](this.planner, this.amount, this.models));
    if (view !== this.view) this.view?.leave();
    this.view = view;
    document.body.dataset.kind = kind;
    this.connection.useCard(card);
    this.card.show(card);
    view.useCard(card);
    byId("layout").inert = false;
  }

  /** What comes back is for the view that has asked, as long as it is looked at. */
  #take(event, detail) {
    this.connection.up();
    const { question, answer, error } = detail;
    const isAnother = answer && answer.model.sha256 !== question.card.sha256;
    if (isAnother || error?.code === "unknown_model") this.#refresh();
    if (question.view === this.view) this.view[event](detail);
  }

  /** Bundles come and go, with a service that was started again or in one that runs. */
  async #refresh() {
    try {
      await this.models.refresh();
    } catch (error) {
      say(error.message);
    }
  }
}

await new App().begin();
