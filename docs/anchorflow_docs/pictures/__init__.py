"""The pictures, a subject a file; `docs/pictures.py` draws them."""
