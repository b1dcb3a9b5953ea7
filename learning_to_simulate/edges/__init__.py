"""Which node acts on which: lists, learned gates, pictures."""
