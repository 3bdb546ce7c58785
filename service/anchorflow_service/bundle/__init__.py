"""Bundles on disk: a folder of manifest.json and ONNX graphs.

manifest   the manifest; the exporter writes it with the same classes
reader     reads a bundle and checks its files before it serves
graphs     runs its graphs in onnxruntime
providers  the execution providers of onnxruntime and their memory
"""

from anchorflow_service.bundle.reader import (
    DEFAULT_BUNDLE as DEFAULT_BUNDLE,
    Bundle as Bundle,
    BundleError as BundleError,
    load_bundle as load_bundle,
)
