"""What parts are made of: tables against the materials themselves."""

import numpy as np
import pytest

from sdfrender import palette
from sdfrender.materials import Diffuse, Glass, Mirror, Normals
from sdfrender.palette import Palette

WALL = Diffuse(type="diffuse", part="wall", colour=(0.1, 0.2, 0.3), texture="brick")
DOOR = Diffuse(type="diffuse", part="door", colour=(0.1, 0.2, 0.3), texture="brick")
FLOOR = Diffuse(type="diffuse", part="floor", texture="tiles")
BARE = Diffuse(type="diffuse", colour=(0.4, 0.5, 0.6))
PANE = Glass(type="glass", part="pane", index=1.7, colour=(0.9, 1.0, 0.8))
LAMP = Glass(type="glass", part="lamp", index=1.3)
CHROME = Mirror(type="mirror", part="chrome", colour=(0.7, 0.6, 0.5))
SHAPE = Normals(type="normals")
ALL = (WALL, PANE, DOOR, CHROME, LAMP, FLOOR, SHAPE, BARE)


def looked_up(engine, made, part):
    def program(xp, part):
        active = part >= 0
        surface = made.look_up(xp, part, active)
        kinds = {f"is{k}": xp.integer(made.made_of(xp, surface, k, active)) for k in range(4)}
        colour = dict(zip("rgb", surface.colour, strict=True))
        return {"kind": surface.kind, "index": surface.index, "texture": surface.texture, **colour, **kinds}

    return engine.run(program, [np.asarray(part, np.int32)])


def test_every_part_by_its_material(choice):
    made = Palette.of(choice.engine, ALL, ["brick", "tiles"])
    part = np.array([7, 0, 1, 2, 3, -1, 4, 5, 6, 0])
    out = looked_up(choice.engine, made, part)
    kinds = {Mirror: palette.MIRROR, Glass: palette.GLASS, Diffuse: palette.DIFFUSE, Normals: palette.NORMALS}
    names = {"brick": 0, "tiles": 1, None: -1}
    for lane, number in enumerate(part):
        if number < 0:  # what missed is of no kind
            assert not any(out[f"is{k}"][lane] for k in range(4))
            continue
        material = ALL[number]
        assert out["kind"][lane] == kinds[type(material)]
        assert [out[f"is{k}"][lane] for k in range(4)] == [k == out["kind"][lane] for k in range(4)]
        assert out["index"][lane] == pytest.approx(getattr(material, "index", 1.0), rel=choice.engine.eps)
        assert out["texture"][lane] == names[getattr(material, "texture", None)]
        colour = getattr(material, "colour", (1.0, 1.0, 1.0))
        assert [out[c][lane] for c in "rgb"] == pytest.approx(colour, rel=choice.engine.eps)


def test_parts_of_one_material_share_it(choice):
    """The part's name is no property of the material; with one for all, no part is looked at."""
    made = Palette.of(choice.engine, ALL, ["brick", "tiles"])
    assert made.several and made.kinds == {0, 1, 2, 3} and len(np.asarray(made.kind)) == len(ALL) - 1
    single = Palette.of(choice.engine, (WALL, DOOR, WALL), ["brick"])
    assert not single.several and single.kinds == {palette.DIFFUSE} and len(np.asarray(single.kind)) == 1
    out = looked_up(choice.engine, single, [0, 2, 99, -1])
    assert out["texture"][:3].tolist() == [0, 0, 0] and out["g"][:3] == pytest.approx(0.2)
    assert out[f"is{palette.DIFFUSE}"].tolist() == [1, 1, 1, 0] and not out[f"is{palette.MIRROR}"].any()


def test_textures_that_are_not_looked_up_have_no_number(choice):
    out = looked_up(choice.engine, Palette.of(choice.engine, ALL, []), [0, 5])
    assert out["texture"].tolist() == [-1, -1]
    out = looked_up(choice.engine, Palette.of(choice.engine, ALL, ["tiles"]), [0, 5])
    assert out["texture"].tolist() == [-1, 0]
