"""Laws that nobody wrote: curves of the learned effects, screened, fitted, judged and read."""
