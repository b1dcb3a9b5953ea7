"""How tools move: the motions of the thesis, of operators, of free drives, of recordings."""
