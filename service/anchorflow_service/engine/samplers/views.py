"""What each picture shows, by the graph `vision`: worked out once a picture.

    vision   pixels [1,3,S,S]                        -> features
    encode   NAME_features of each picture, …        -> …

A roadside camera sends the same picture to many, and may be left out: of optional pictures the
features are remembered by what they show, up to MEMORY bytes.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Iterator

import numpy as np

from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.graphs import WideGraph
from anchorflow_service.bundle.manifest import Manifest, VisionLanguageEntry
from anchorflow_service.engine.conditioning.vision_language import HAS, TOKENS, VisionLanguageScene
from anchorflow_service.engine.parts import Array, Arrays, ConditionedScene, missing_roles

VISION = "vision"
PIXELS, FEATURES = "pixels", "features"
MEMORY = 64 * 2**20
"""Bytes of features that are kept."""


class Views:
    """The graph `vision` of a bundle, opened; several threads may look at once."""

    def __init__(self, bundle: Bundle, *, threads: int, provider: str) -> None:
        manifest = bundle.manifest
        assert isinstance(manifest.conditioning, VisionLanguageEntry)
        self._images = manifest.conditioning.images
        optional = {spec.name for spec in manifest.request.inputs if spec.optional}
        self._remembered_images = optional & set(self._images)
        self._graph = WideGraph(bundle, VISION, threads=threads, provider=provider)
        shape = manifest.graphs[VISION].outputs[0].shape[1:]
        self._nothing = np.zeros((1, *map(int, shape)), np.float32)
        self._memory: OrderedDict[bytes, Array] = OrderedDict()
        self._lock = threading.Lock()

    @property
    def remembered(self) -> int:
        """Pictures whose features are kept at present."""
        return len(self._memory)

    def settle(self, scene: ConditionedScene) -> None:
        """Look whether the graph gives the same bytes on one thread and on many."""
        self._graph.settle({PIXELS: scene.inputs(self._images[:1])[self._images[0]]})

    def features(self, scene: ConditionedScene, *, threads: int) -> Arrays:
        """Of every picture of a scene, by the names that encode takes them by."""
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
        return self._graph({PIXELS: pixels}, threads=threads)[FEATURES]


def view_faults(manifest: Manifest) -> Iterator[str]:
    """What keeps pictures and tokens from reaching the graphs."""
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
    """The same for the same pixels in the same shape."""
    digest = hashlib.blake2b(repr(picture.shape).encode(), digest_size=32)
    digest.update(np.ascontiguousarray(picture).data)
    return digest.digest()
