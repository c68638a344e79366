"""From rows on the bus to estimates at every tick: clocks, alignment, the 50 Hz loop and its estimators."""
