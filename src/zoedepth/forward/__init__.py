"""From photos to what a network says of them at their size: padded, resized, mirrored and averaged, resized back.

``tensors`` does so with torch, for models of torch; ``arrays`` without it, for exported ones. ``Predictor`` chooses.
"""
