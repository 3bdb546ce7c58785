"""Bundles on disk: a folder of manifest.json and ONNX graphs.

manifest   what manifest.json says; the exporter writes it with the same classes
samplers   what it says of how anchors are drawn
reader     a bundle read, and checked before it serves
graphs     its graphs, opened by onnxruntime
providers  where onnxruntime runs them
device     the memory that they compute in there
"""

from anchorflow_service.bundle.reader import DEFAULT_BUNDLE, Bundle, BundleError, load_bundle

__all__ = ["DEFAULT_BUNDLE", "Bundle", "BundleError", "load_bundle"]
