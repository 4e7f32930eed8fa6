"""Panels drawn without a window: what they would show is noted."""

import types

import bpy

from raybatch_addon.ui.panel import label_width

ENGINE = "RAYBATCH"


def own_panels():
    own = [panel for panel in bpy.types.Panel.__subclasses__() if panel.__name__.startswith(f"{ENGINE}_")]
    return [panel for panel in own if panel.bl_region_type != "HEADER"]  # menus of presets are panels too


def enabled_panels():
    return {
        panel.__name__ for panel in bpy.types.Panel.__subclasses__() if ENGINE in getattr(panel, "COMPAT_ENGINES", ())
    }


class Layout:
    """A layout that notes what is drawn, and only takes properties that exist.

    `grey` has the names of the properties that stand where they cannot be set, `unheard` of those that can be set and
    have no say; `whys` what is said in grey letters.
    """

    def __init__(self, notes=None, above=None):
        self.notes = [] if notes is None else notes
        self.grey, self.unheard, self.whys = ([], [], []) if above is None else (above.grey, above.unheard, above.whys)
        self.enabled, self.active, self._above = True, True, above

    @property
    def is_enabled(self):
        return self.enabled and (self._above is None or self._above.is_enabled)

    @property
    def is_active(self):
        return self.active and (self._above is None or self._above.is_active)

    def column(self, *_args, **_options):
        return Layout(self.notes, self)

    row = box = split = grid_flow = column

    def label(self, text="", icon="NONE", icon_value=0):
        assert icon in bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items
        if not self.is_active:
            self.whys.append(text)
        self.notes.append(("label", text, icon))

    def popover(self, panel, icon="NONE", text=""):
        assert issubclass(getattr(bpy.types, panel), bpy.types.Panel)
        self.notes.append(("popover", panel, icon))

    def template_icon(self, icon_value, scale=1.0):
        self.notes.append(("icon", icon_value, scale))

    def separator(self):
        self.notes.append(("separator", "", ""))

    def template_list(self, kind, _name, owner, collection, active_owner, active, **_options):
        assert hasattr(bpy.types, kind) and collection in owner.bl_rna.properties
        assert active in active_owner.bl_rna.properties
        self.notes.append(("list", kind, collection))

    def template_node_view(self, tree, node, _socket):
        assert tree.nodes[node.name] == node
        self.notes.append(("nodes", tree.name, node.name))

    def template_curve_mapping(self, owner, name):
        assert owner.bl_rna.properties[name].fixed_type.identifier == "CurveMapping"
        self.notes.append(("curve", owner.bl_rna.identifier, name))

    def prop_enum(self, owner, name, value):
        assert value in owner.bl_rna.properties[name].enum_items
        self.notes.append(("choice", owner.bl_rna.identifier, name, value))

    def prop_search(self, owner, name, source, collection, **_options):
        assert name in owner.bl_rna.properties and collection in source.bl_rna.properties
        self.notes.append(("prop", owner.bl_rna.identifier, name))

    def operator(self, name, text="", emboss=True, icon="NONE", depress=False):
        assert icon in bpy.types.UILayout.bl_rna.functions["operator"].parameters["icon"].enum_items
        group, _, each = name.partition(".")
        known = getattr(getattr(bpy.ops, group), each).get_rna_type().properties.keys()
        button = types.SimpleNamespace()
        self.notes.append(("operator", name, text, button, known))
        return button

    def menu(self, name, text="", icon="NONE"):
        assert issubclass(getattr(bpy.types, name), bpy.types.Menu)
        self.notes.append(("menu", name, icon))

    def prop(self, owner, name, **_options):
        assert name in owner.bl_rna.properties, name
        self.notes.append(("prop", owner.bl_rna.identifier, name))
        if not self.is_enabled:
            self.grey.append(name)
        elif not self.is_active:
            self.unheard.append(name)


def drawn(panel, context, draw="draw"):
    return layout_of(panel, context, draw).notes


def layout_of(panel, context, draw="draw"):
    """The layout of a panel, drawn."""
    layout = Layout()
    getattr(panel, draw)(types.SimpleNamespace(layout=layout, group=getattr(panel, "group", None)), context)
    return layout


def context_of(scene, **extra):
    area = types.SimpleNamespace(width=300, as_pointer=lambda: 1)
    preferences = types.SimpleNamespace(system=types.SimpleNamespace(ui_scale=1.0))  # it is 0 without a window
    own = dict(scene=scene, view_layer=scene.view_layers[0], engine=ENGINE, region=area, object=None, light=None)
    return types.SimpleNamespace(**{**own, "preferences": preferences, **extra})


# Seen in Blender's window, where the Properties editor has its first width, 282, without its tabs [pixels]
FIRST_WIDTH = 252
INNER_WIDTH = 216  # of a panel's content
_VALUE_SHARE, _PANEL_MARGIN = 0.6, 44  # a panel beside names and values; of what is left the values' share
_BOX_MARGIN, _NUMBER = 18, 70
_ICON, _CHECKBOX, _ARROW, _BUTTON, _DOT = 20, 23, 23, 8, 20  # what is not text of a button, or stands beside it


class Measured(Layout):
    """A layout that notes as `cut` what does not fit its place, as Blender gives places to names and values."""

    def __init__(self, width=FIRST_WIDTH - _PANEL_MARGIN, above=None, is_split=True):
        super().__init__(None if above is None else above.notes, above)
        self.width, self.use_property_split = width, is_split
        self.use_property_decorate = above is not None and above.use_property_decorate
        self._checks = [] if above is None else above._checks  # text, room without other buttons, where it stands
        self._shares, self._taken, self._named = [], 0, width
        # of a panel whose content has `INNER_WIDTH`, what its rows of names and values have less
        self._margin = max(0, width - FIRST_WIDTH + _PANEL_MARGIN) if above is None else above._margin

    @property
    def cut(self):
        """The texts that are cut off, with their widths."""
        places = [(text, room - place._taken) for text, room, place in self._checks]
        return [
            f"{text}: {label_width(text):.0f} pixels, where there are {room:.0f}"
            for text, room in places
            if label_width(text) > room
        ]

    def _part(self, width=None, is_split=None):
        is_split = self.use_property_split if is_split is None else is_split
        part = Measured(self._place() if width is None else width, self, is_split)
        part._named = part.width if self._named == self.width else self._named
        return part

    def _place(self):
        return self.width * self._shares.pop(0) if self._shares else self.width

    def row(self, **_options):
        return self._part()

    def box(self, **_options):
        return self._part(self._place() - _BOX_MARGIN)

    def grid_flow(self, **_options):
        return self._part()

    def column(self, heading="", **_options):
        if not heading:
            return self._part()
        width = self.width - self._margin
        self._check(heading, (1 - _VALUE_SHARE) * width)
        part = self._part(_VALUE_SHARE * width, is_split=False)
        part._named = self.width  # other names than of checkboxes stand where the heading does
        return part

    def split(self, factor=0.5, **_options):
        part = self._part()
        part._shares = [factor, 1 - factor]
        return part

    def _check(self, text, room):
        self._checks.append((text, room, self))

    def label(self, text="", icon="NONE", icon_value=0):
        super().label(text, icon, icon_value)
        self._check(text, self._place() - _BUTTON - (_ICON + 5 if icon != "NONE" or icon_value else 0))

    def operator(self, name, text=None, emboss=True, icon="NONE", depress=False):
        if text == "":
            self._taken += _ICON  # of what others in this row have
        else:
            group, _, each = name.partition(".")
            shown = getattr(getattr(bpy.ops, group), each).get_rna_type().name if text is None else text
            self._check(shown, self._place() - (_ICON if icon != "NONE" else _BUTTON))
        return super().operator(name, text or "", emboss, icon, depress)

    def prop_enum(self, owner, name, value):
        super().prop_enum(owner, name, value)
        self._check(owner.bl_rna.properties[name].enum_items[value].name, self._place() - _BUTTON)

    def prop_search(self, owner, name, source, collection, text=None, **options):
        super().prop_search(owner, name, source, collection, **options)
        if self.use_property_split:
            self._check(
                owner.bl_rna.properties[name].name if text is None else text,
                (1 - _VALUE_SHARE) * (self.width - self._margin),
            )

    def prop(self, owner, name, text=None, **options):
        super().prop(owner, name, **options)
        found, room = owner.bl_rna.properties[name], self._place()
        shown = found.name if text is None else text
        if found.type != "BOOLEAN" and (self.use_property_split or self._named != self.width):
            self._check(shown, (1 - _VALUE_SHARE) * (self._named - self._margin))
        if self.use_property_split:
            room = (room - self._margin) * _VALUE_SHARE
        room -= _DOT if self.use_property_decorate else 0
        is_in_field = not self.use_property_split and self._named == self.width
        if shown and is_in_field and found.type in ("INT", "FLOAT"):
            self._check(shown, room - _NUMBER)
        if found.type == "BOOLEAN":
            self._check(shown, room - _CHECKBOX)
        elif found.type == "ENUM":
            value = getattr(owner, name)
            self._check(
                next((item.name for item in found.enum_items if item.identifier == value), value), room - _ARROW
            )
