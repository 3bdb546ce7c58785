"""The bundle reader, the engine and the endpoints. Never torch."""
