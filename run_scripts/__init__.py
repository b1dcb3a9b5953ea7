"""What a person runs: environment, demonstration, tests, site, training of the shipped models. Run
everything from the project root."""
