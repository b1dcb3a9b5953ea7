"""What may be printed: names and files of others cannot control a terminal."""

_MAX_MESSAGE = 4000  # a message may quote what a file holds


def printable(text: object) -> str:
    """Returns a message as it may be printed: what files and names hold cannot control a terminal.

    Control characters become escapes, line breaks and tabs stay; what is longer than a few
    thousand characters is cut.
    """
    shown = ''.join(
        character if character.isprintable() or character in '\n\t' else repr(character)[1:-1]
        for character in str(text)[: _MAX_MESSAGE + 1]
    )
    return shown if len(str(text)) <= _MAX_MESSAGE else f'{shown[:_MAX_MESSAGE]} ... (cut)'
