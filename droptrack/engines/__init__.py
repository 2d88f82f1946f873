"""Detection engines, one file each."""
