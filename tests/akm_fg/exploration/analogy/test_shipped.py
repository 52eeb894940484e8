"""The memory that comes with the package."""

from __future__ import annotations

from akm_fg.config import AkmConfig
from akm_fg.exploration.analogy.shipped import SHIPPED, shipped_memory


def test_the_shipped_memory_is_small_of_training_objects_and_for_the_default_features() -> None:
    memory = shipped_memory()
    assert sum(file.stat().st_size for file in SHIPPED.iterdir()) < 2_000_000
    assert len(memory.contacts) >= 25
    assert all(contact.object_name.startswith("furniture-dev/") for contact in memory.contacts)
    assert len({contact.family for contact in memory.contacts}) >= 6
    assert {contact.kind for contact in memory.contacts} == {"prismatic", "revolute"}
    assert AkmConfig().stages.features == "efficientnet"
    assert memory.made_by == "efficientnet-lite0/10/448"
    for contact in memory.contacts:
        h, w = contact.crop_mask.shape
        u, v = contact.contact_uv
        assert -1 <= u <= w and -1 <= v <= h
