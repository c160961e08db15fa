"""What went wrong with the user's input, in one sentence.

Every room raises `BadInput` for what a user can mend; the command lines turn it into one line on standard error and
exit code 2. Anything else that escapes is a defect of ours and keeps its traceback.
"""


class BadInput(Exception):
    """One sentence for the user: what is wrong, where, and what to do."""
