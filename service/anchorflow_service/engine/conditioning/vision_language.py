"""Conditioning on pictures and a text: pixels of the size that the model sees, and tokens."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from anchorflow_client.contract import AnchorRequest, ResolvedRequest
from anchorflow_client.contract.fields import MAX_PIXELS
from anchorflow_client.contract.inputs import TEXT
from anchorflow_client.errors import InvalidRequest
from anchorflow_client.sensors import resized
from anchorflow_service.bundle import Bundle, BundleError
from anchorflow_service.bundle.manifest import VisionLanguageEntry
from anchorflow_service.engine.conditioning.tensors import probe_of
from anchorflow_service.engine.parts import Array, Arrays

if TYPE_CHECKING:
    from tokenizers import Tokenizer

TOKENS = "tokens"
TOKENIZER = "tokenizer"
HAS = "has_"
"""Before the name of an optional picture: whether the request brought it."""


class VisionLanguageConditioning:
    """Scenes of pictures and a text.

    Raises:
        BundleError: the bundle has no tokenizer, it cannot be read, or the extra `language` is not
            installed.
    """

    def __init__(self, bundle: Bundle) -> None:
        self._manifest = bundle.manifest
        assert isinstance(bundle.manifest.conditioning, VisionLanguageEntry)
        self._entry = bundle.manifest.conditioning
        if TOKENIZER not in bundle.manifest.files:
            raise bundle.fault(f"files: expected {TOKENIZER}, the text's, got none of this name")
        self._tokenizer = _tokenizer(bundle)

    def faults(self) -> Iterator[str]:
        """Pictures and texts that no request brings, and inputs of encode that are made of none."""
        entry = self._entry
        given = {spec.name: spec for spec in self._manifest.request.inputs}
        for name, dtype in (*((name, "uint8") for name in entry.images), (entry.text, TEXT)):
            if name not in given or given[name].dtype != dtype:
                yield f"conditioning: expected {name} of {dtype} among request.inputs"
        for name in given:
            if name not in (*entry.images, entry.text):
                yield f"request.inputs: conditioning has no use for {name}"
        if entry.text in given and given[entry.text].optional:
            yield f"request.inputs: {entry.text} is optional, expected only pictures to be"

    def scenes(self, request: ResolvedRequest) -> list[VisionLanguageScene]:
        """The scenes of a request. Raises `InvalidRequest` for a picture or a text too large."""
        for name in self._entry.images:
            picture = request.inputs.get(name)
            height, width = picture.shape[-2:] if isinstance(picture, np.ndarray) else (1, 1)
            if height * width > MAX_PIXELS:
                most = f"a picture of at most {MAX_PIXELS} pixels"
                raise InvalidRequest(f"expected {most}, got {width} x {height}", f"inputs.{name}")
        texts = np.asarray(request.inputs[self._entry.text])
        tokens = [self._tokens(text) for text in texts]
        return [
            VisionLanguageScene(request, b, tokens[b], self._entry.image_size)
            for b in range(request.num_scenes)
        ]

    def probe(self) -> AnchorRequest:
        """Black pictures and a word; what is optional too, so that every graph is run."""
        inputs = {spec.name: probe_of(spec) for spec in self._manifest.request.inputs}
        return AnchorRequest.build(inputs=inputs, seed=0)

    def _tokens(self, text: str) -> Array:
        tokens = self._tokenizer.encode(text).ids
        if len(tokens) > self._entry.max_tokens:
            most = f"a text of at most {self._entry.max_tokens} tokens"
            field = f"inputs.{self._entry.text}"
            raise InvalidRequest(f"expected {most}, got {len(tokens)}", field)
        return np.array(tokens, np.int64)[None]


@dataclass(frozen=True)
class VisionLanguageScene:
    """One scene of a request."""

    request: ResolvedRequest
    index: int
    tokens: Array
    """[1,L] int64."""
    image_size: int

    def has(self, name: str) -> bool:
        """Whether the request brought a picture."""
        return name in self.request.inputs

    def picture(self, name: str) -> Array:
        """[3,H,W] as it came."""
        return np.asarray(self.request.inputs[name])[self.index]

    def inputs(self, names: Iterable[str]) -> Arrays:
        """Tokens, pixels [1,3,S,S] and what is there, by name."""
        return {name: self._input(name) for name in names}

    def _input(self, name: str) -> Array:
        if name == TOKENS:
            return self.tokens
        if name.startswith(HAS):
            return np.array([self.has(name.removeprefix(HAS))])
        return np.ascontiguousarray(resized(self.picture(name), self.image_size))[None]

    def answered(self, arrays: Arrays) -> Arrays:
        """As they are: the frame is the planner's own."""
        return arrays


def _tokenizer(bundle: Bundle) -> Tokenizer:
    try:
        from tokenizers import Tokenizer
    except ModuleNotFoundError as error:
        missing = "needs tokenizers, which is not installed"
        raise bundle.fault(f"{missing}: pip install 'anchorflow[language]'") from error
    path = bundle.file_path(TOKENIZER)
    try:
        return Tokenizer.from_str(path.read_text("utf-8"))
    except Exception as error:  # the library's own exceptions are plain `Exception`s
        raise BundleError(path, "is no tokenizer", str(error)) from error
