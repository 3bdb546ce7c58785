"""Pictures of the documentation; `docs/pictures.py` draws them."""
