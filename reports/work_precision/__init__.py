"""Error against run time: what is compared, how it is measured, and the report made of it.

`points` holds one measured row, `families` what is compared, `measure` takes one row's numbers,
`survey` walks through all rows, `tables` and `pictures` turn the stored JSON into the report.
"""
