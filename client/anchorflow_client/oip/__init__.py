"""The Open Inference Protocol v2 with its binary tensor extension, as far as anchors need it.

datatypes   the protocol's names of numpy's types
message     a JSON header, padded, and the tensors behind it
parameters  the contract's scalar fields as the protocol's parameters
"""
