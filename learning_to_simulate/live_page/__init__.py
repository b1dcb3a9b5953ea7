"""The live page: a model under a tool that is moved in a browser."""
