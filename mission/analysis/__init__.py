"""What is made of recordings: reports, comparisons, exports."""
