from __future__ import annotations

from pathlib import Path

from sim.camera.materials import MATT, specular_of


def mesh(folder: Path, name: str, mtl: str) -> str:
    (folder / f"{name}.mtl").write_text(mtl, encoding="utf-8")
    return str(folder / f"{name}.obj")


def test_names_of_mesh_material_and_texture_tell_what_is_shiny(tmp_path: Path):
    painted = mesh(tmp_path, "part_front", "newmtl surface\nKs 0.5 0.5 0.5\nmap_Kd front.png\n")
    assert specular_of(painted) == MATT  # exporters write Ks 0.5 for everything
    by_texture = mesh(tmp_path, "a", "newmtl surface\nmap_Kd textures/Brushed.png\n")
    by_material = mesh(tmp_path, "b", "newmtl oven_glass\n\n")
    assert specular_of(by_texture) == 0.6 and specular_of(by_material) == 0.9
    assert specular_of(str(tmp_path / "part_handle.obj")) == 0.6  # without an MTL


def test_a_primitive_is_matt():
    assert specular_of("") == MATT
