"""The network of the paper's Fig. 2: encoder, decoder, router, and ``ZoeDepth``, which joins them with the heads."""
