"""Everything a person can do, as one table: menus, tool bar, shortcut sheet and the browser's
buttons are made from it, so that none of them can lack what another has."""

from annotator.actions.action import Action
from annotator.actions.align import ALIGN_ACTIONS
from annotator.actions.objects import OBJECT_ACTIONS
from annotator.actions.scene import SCENE_ACTIONS
from annotator.actions.view import VIEW_ACTIONS

ACTIONS = (*SCENE_ACTIONS, *VIEW_ACTIONS, *OBJECT_ACTIONS, *ALIGN_ACTIONS)
BY_ID = {a.id: a for a in ACTIONS}
MENUS = ("File", "Edit", "View", "Frame", "Object", "Align", "Help")

__all__ = ["ACTIONS", "BY_ID", "MENUS", "Action"]
