"""What trainable models share: data, fields and their derivatives, training."""
