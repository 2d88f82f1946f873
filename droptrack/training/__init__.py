"""Images and labels -> weights, by Darknet or PyTorch; what a training needs before and after."""
