"""Students of a trained flow that need one to four evaluations of their field."""
