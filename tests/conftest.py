import os

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # pygame's windows go nowhere
