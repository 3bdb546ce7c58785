"""How the default bundle learned."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from anchorflow_docs.pictures.scenes import Stage
from anchorflow_docs.pictures.theme import WIDTH, Drawing, Theme


def loss(stage: Stage) -> Drawing:
    """The training loss, as the bundle's manifest holds it."""
    card = stage.engine.card
    steps, values = np.array(card.training["loss"]).T

    def draw(theme: Theme) -> Figure:
        figure, axis = plt.subplots(figsize=(WIDTH * 0.8, 3.2), layout="constrained")
        axis.plot(steps, values, color=theme.ways[0])
        axis.set(xlabel="step", ylabel="loss", yscale="log", title=card.name)
        axis.grid()
        return figure

    return draw
