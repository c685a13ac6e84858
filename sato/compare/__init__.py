"""One question, every solver: each answer judged by what is recomputed, each time a median."""
