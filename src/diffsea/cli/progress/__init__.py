"""What a command shows somebody who waits: stage, time left, and what is being compiled.

Nothing here imports a numerical library; of the room it may import `options`.
"""
