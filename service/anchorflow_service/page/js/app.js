/** Puts the page together: the view of the chosen bundle's kind asks the planner and shows its anchors. */

import { Bundles } from "./bundles.js";
import { byId } from "./dom.js";
import { Form, RequestFields } from "./fields.js";
import { say } from "./figures.js";
import { MapView } from "./map/view.js";
import { Connection, Planner } from "./planner.js";
import { ask } from "./service.js";
import { TensorView } from "./tensors/view.js";

/** By the conditioning of a card; any other kind gets a field for each input of its card. */
const VIEWS = { cost_map: MapView, tensors: TensorView };
const FIRST_WAIT_MS = 250;
const LONGEST_WAIT_MS = 4000;
/** Seeds of the button "Another" are smaller, so that one can read them out. */
const SHORT_SEED = 1e6;

/**
 * A view has question(), useCard(card), leave(), choose(options) with fields of the form by path,
 * answered({question, answer, sentAt}), refused({question, error}) and down().
 */
class App {
  #views = {};
  /** null until a bundle is known. */
  #view = null;

  constructor() {
    this.connection = new Connection(() => this.planner.retry());
    this.bundles = new Bundles((card) => this.#use(card));
    this.planner = new Planner({
      question: () => ({ ...this.#view?.question(), view: this.#view }),
      onAnswer: (exchange) => this.#take("answered", exchange),
      onRefusal: (exchange) => this.#take("refused", exchange),
      onDown: (state) => {
        this.connection.down(state);
        this.#view?.down();
      },
      onUp: () => {
        this.connection.up();
        this.#refresh();
      },
    });
    byId("ask").addEventListener("submit", (event) => event.preventDefault());
    byId("help-open").addEventListener("click", () => byId("help").showModal());
    byId("reseed").addEventListener("click", () => this.#view.choose({ seed: Math.floor(Math.random() * SHORT_SEED) }));
  }

  /** Read the request's schema and the cards; a service that is still starting is waited for. */
  async begin() {
    this.planner.watch();
    for (let wait = FIRST_WAIT_MS; ; wait = Math.min(2 * wait, LONGEST_WAIT_MS)) {
      try {
        this.form ??= new Form(new RequestFields(await ask("openapi.json")), (options) => this.#view.choose(options));
        await this.bundles.refresh();
        return;
      } catch (error) {
        this.connection.wait(error.message);
        await new Promise((resolve) => setTimeout(resolve, wait));
      }
    }
  }

  #use(card) {
    const kind = card.conditioning.kind in VIEWS ? card.conditioning.kind : "tensors";
    const view = (this.#views[kind] ??= new VIEWS[kind](this));
    if (view !== this.#view) this.#view?.leave();
    this.#view = view;
    document.body.dataset.kind = kind;
    this.connection.card = card;
    this.connection.up();
    view.useCard(card);
    byId("layout").inert = false;
  }

  /** Pass a response on to the view that has asked, if it is still the one on the page. */
  #take(event, exchange) {
    this.connection.up();
    const { question, answer, error } = exchange;
    const isAnother = answer && answer.model.sha256 !== question.card.sha256;
    if (isAnother || error?.code === "unknown_model") this.#refresh();
    if (question.view === this.#view) this.#view[event](exchange);
  }

  /** Bundles may be loaded and unloaded while the service runs; the first cards are read by begin(), after the form. */
  async #refresh() {
    if (!this.form) return;
    try {
      await this.bundles.refresh();
    } catch (error) {
      say(error.message);
    }
  }
}

await new App().begin();
