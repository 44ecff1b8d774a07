"""The network of the paper's Fig. 2: encoder, decoder, router, and ``ZoeDepth`` that joins them with the metric heads."""
