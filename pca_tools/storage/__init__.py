"""What all packages share: files and folders that appear whole or not at all, folders with one
writer, tables. It needs the standard library alone.
"""
