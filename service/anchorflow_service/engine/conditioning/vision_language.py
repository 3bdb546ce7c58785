"""Conditioning on pictures and a text: pixels of the model's size, features of them, and tokens.

    vision   pixels [1,3,S,S]                        -> features, once a picture
    encode   NAME_features of each picture, …        -> …

A roadside camera sends the same picture to many robots, and may be left out: the features of
optional pictures are remembered by their content, up to MEMORY bytes.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from anchorflow_client.contract import AnchorRequest, ResolvedRequest
from anchorflow_client.contract.fields import MAX_PIXELS
from anchorflow_client.contract.inputs import TEXT
from anchorflow_client.errors import InvalidRequest, how_to_install
from anchorflow_client.sensors import resized
from anchorflow_service.bundle import Bundle, BundleError
from anchorflow_service.bundle.entries import VisionLanguageEntry
from anchorflow_service.bundle.manifest import Manifest
from anchorflow_service.engine.conditioning.tensors import probe_of
from anchorflow_service.engine.interfaces import (
    Array,
    Arrays,
    ConditionedScene,
    Graphs,
    missing_roles,
)

if TYPE_CHECKING:
    from tokenizers import Tokenizer

TOKENS = "tokens"
TOKENIZER = "tokenizer"
HAS = "has_"
"""Prefix of an optional picture's name: whether the request brought it."""
VISION = "vision"
PIXELS, FEATURES = "pixels", "features"
MEMORY = 64 * 2**20
"""Bytes of features that are kept."""


class VisionLanguageConditioning:
    """Reads scenes of pictures and a text. Raises `BundleError` if the tokenizer cannot be read."""

    def __init__(self, bundle: Bundle) -> None:
        self._manifest = bundle.manifest
        assert isinstance(bundle.manifest.conditioning, VisionLanguageEntry)
        self._entry = bundle.manifest.conditioning
        if TOKENIZER not in bundle.manifest.files:
            raise bundle.fault(f"files: expected {TOKENIZER}, the text's, got none of this name")
        self._tokenizer = _tokenizer(bundle)

    def faults(self) -> Iterator[str]:
        """Find pictures and texts that no request brings, and inputs that nothing uses."""
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
        """Return a request's scenes. Raises `InvalidRequest` if a picture or text is too large."""
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
        """Return black pictures and a word, optional ones included, so that every graph is run."""
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
        return name in self.request.inputs

    def picture(self, name: str) -> Array:
        """Return a picture [3,H,W] as it came."""
        return np.asarray(self.request.inputs[name])[self.index]

    def inputs(self, names: Iterable[str]) -> Arrays:
        """Return tokens, pixels [1,3,S,S] and which pictures are there, by name."""
        return {name: self._input(name) for name in names}

    def _input(self, name: str) -> Array:
        if name == TOKENS:
            return self.tokens
        if name.startswith(HAS):
            return np.array([self.has(name.removeprefix(HAS))])
        return np.ascontiguousarray(resized(self.picture(name), self.image_size))[None]

    def answered(self, arrays: Arrays) -> Arrays:
        return arrays


class Views:
    """Features of pictures by the graph `vision`; several threads may look at once."""

    def __init__(self, manifest: Manifest, graphs: Graphs) -> None:
        assert isinstance(manifest.conditioning, VisionLanguageEntry)
        self._images = manifest.conditioning.images
        optional = {spec.name for spec in manifest.request.inputs if spec.optional}
        self._remembered_images = optional & set(self._images)
        self._graphs = graphs
        shape = manifest.graphs[VISION].outputs[0].shape[1:]
        self._nothing = np.zeros((1, *map(int, shape)), np.float32)
        self._memory: OrderedDict[bytes, Array] = OrderedDict()
        self._lock = threading.Lock()

    @property
    def remembered(self) -> int:
        """The number of pictures whose features are kept."""
        return len(self._memory)

    def settle(self, scene: ConditionedScene) -> None:
        self._graphs.settle(VISION, {PIXELS: scene.inputs(self._images[:1])[self._images[0]]})

    def features(self, scene: ConditionedScene, *, threads: int) -> Arrays:
        """Return the features of every picture of a scene, by encode's names for them."""
        assert isinstance(scene, VisionLanguageScene)
        return {
            f"{name}_{FEATURES}": self._of(name, scene, threads)
            if scene.has(name)
            else self._nothing
            for name in self._images
        }

    def _of(self, name: str, scene: VisionLanguageScene, threads: int) -> Array:
        if name not in self._remembered_images:
            return self._seen(name, scene, threads)
        key = _content(scene.picture(name))
        with self._lock:
            if key in self._memory:
                self._memory.move_to_end(key)
                return self._memory[key]
        features = self._seen(name, scene, threads)
        with self._lock:
            self._memory[key] = features
            while len(self._memory) * features.nbytes > MEMORY:
                self._memory.popitem(last=False)
        return features

    def _seen(self, name: str, scene: VisionLanguageScene, threads: int) -> Array:
        pixels = scene.inputs((name,))[name]
        return self._graphs.run(VISION, {PIXELS: pixels}, threads=threads)[FEATURES]


def view_faults(manifest: Manifest) -> Iterator[str]:
    """Find what keeps pictures and tokens from reaching the graphs."""
    entry = manifest.conditioning
    assert isinstance(entry, VisionLanguageEntry)
    if missing := list(missing_roles(manifest, (VISION,))):
        yield from missing
        return
    vision, encode = manifest.graphs[VISION], manifest.graphs["encode"]
    if (vision.input_names, vision.output_names) != ((PIXELS,), (FEATURES,)):
        yield f"graphs.{VISION}: expected {PIXELS} to {FEATURES}, got {vision.input_names}"
    optional = [spec.name for spec in manifest.request.inputs if spec.optional]
    wanted = {
        *(f"{name}_{FEATURES}" for name in entry.images),
        TOKENS,
        *(HAS + n for n in optional),
    }
    if set(encode.input_names) != wanted:
        came = ", ".join(encode.input_names)
        yield f"graphs.encode.inputs: expected {', '.join(sorted(wanted))}, got {came}"


def _content(picture: Array) -> bytes:
    """Return a key that is the same for the same pixels in the same shape."""
    digest = hashlib.blake2b(repr(picture.shape).encode(), digest_size=32)
    digest.update(np.ascontiguousarray(picture).data)
    return digest.digest()


def _tokenizer(bundle: Bundle) -> Tokenizer:
    try:
        from tokenizers import Tokenizer
    except ModuleNotFoundError as error:
        missing = "needs tokenizers, which is not installed"
        raise bundle.fault(f"{missing}: {how_to_install('language')}") from error
    path = bundle.file_path(TOKENIZER)
    try:
        return Tokenizer.from_str(path.read_text("utf-8"))
    except Exception as error:  # the library's own exceptions are plain `Exception`s
        raise BundleError(path, "is no tokenizer", str(error)) from error
