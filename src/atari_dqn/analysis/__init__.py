"""Numbers and verdicts from stored runs. Draws nothing, and loads neither PyTorch nor a drawing
library."""
