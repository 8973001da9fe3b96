"""An approximate matcher for tactile-loc that searches a graph of neighbours with usearch."""
