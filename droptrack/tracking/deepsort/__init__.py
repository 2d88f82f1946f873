"""DeepSORT (Wojke et al. 2017), as the original program computes it."""
