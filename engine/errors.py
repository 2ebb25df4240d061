"""The errors that Lobe raises on purpose. Their text is for the user: what is wrong, where, and what to do."""


class LobeError(Exception):
    """Base of every error whose message may be shown to the user as it stands."""


class SceneError(LobeError):
    """The scene description cannot be rendered: names the object at fault."""


class SettingsError(LobeError):
    """A render setting is out of its range: names the setting."""
