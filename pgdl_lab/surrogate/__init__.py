"""What a trained model can be asked, in NumPy alone: predict, error bar, inverse, files, viewer."""
