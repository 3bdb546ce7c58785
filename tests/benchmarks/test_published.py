"""What `anchorflow bench published` trains, and what it reads of the proof."""

from __future__ import annotations

import math
from pathlib import Path

from command_line import failure
from small_configs import EXAMPLES

from anchorflow_benchmarks.published import DIFFERENCE, PUBLISHED, WORDS, tokenizer
from anchorflow_export.parity import Difference
from anchorflow_training.settings import PLANNER, text_in
from anchorflow_training.v2x.text import opened, read_tokenizer


def test_every_published_configuration_is_measured() -> None:
    files = {
        path.name.removesuffix("-published.yaml") for path in EXAMPLES.glob("*-published.yaml")
    }
    assert {each.file for each in PUBLISHED.values()} == files
    for each in PUBLISHED.values():
        planner = text_in(EXAMPLES / f"{each.file}-published.yaml", PLANNER)
        assert each.of_pairs == (planner == "v2x_vlm")
    assert "expected names of wote, " in failure("bench", "published", "wotte")


def test_the_proof_is_read_to_its_worst() -> None:
    told = [Difference("encode at B=1, dx: 3", 2.5e-6), Difference("sample", 4e-5)]
    assert [*map(float, DIFFERENCE.findall("\n".join(map(str, [*told, "out: name 0.1.0"]))))] == [
        2.5e-6,
        4e-5,
    ]
    (wrong,) = DIFFERENCE.findall(str(Difference("sample", math.nan)))
    assert math.isnan(float(wrong))


def test_a_tokenizer_has_as_many_words_as_florence(tmp_path: Path) -> None:
    made = opened(read_tokenizer(tokenizer(tmp_path)))
    assert made.get_vocab_size() == WORDS
    assert len(made.encode("The ego vehicle drives.").ids) < 40
