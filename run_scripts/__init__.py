"""What a person runs: demonstration, tests, reports. Run everything from the project root."""
