"""Drive a robot among people: replayed recordings, and simulated people who react to it."""
