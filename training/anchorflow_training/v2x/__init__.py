"""V2X-VLM's training: from a cooperative recording to a checkpoint."""
