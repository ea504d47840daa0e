"""The SROS2 policy of the documentation allows what a real front offers, and nothing else."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import pytest
from pages import DOCS, sections
from waiting import until

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")
pytest.importorskip("robot_arm_interfaces")

from config.loader import load_arm
from handbook.ros import actions_of, node_of

pytestmark = pytest.mark.process  # a real node

PAGES = pytest.mark.parametrize("page", ["explanation/security.md", "explanation/security.zh.md"])
NODE = "episode_arm_controller"
KINDS = ("actions execute", "services reply", "topics subscribe", "topics publish")
PATIENCE_S = 10.0


def allowed(page: str, enclave: str, node: str) -> dict[str, set[str]]:
    """Whole names by what a node may do with them (`topics publish` …), from the policy of a page."""
    text = (DOCS / page).read_text(encoding="utf-8")
    (block,) = (block for section in sections(text) for block in section.blocks if block.info == "xml")
    profile = ElementTree.fromstring("\n".join(block.lines)).find(
        f".//enclave[@path='{enclave}']//profile[@node='{node}']"
    )
    assert profile is not None
    whole_names: dict[str, set[str]] = {}
    for group in profile:
        (permission, answer), *others = group.attrib.items()
        assert answer == "ALLOW" and not others
        names = {str(entry.text) for entry in group}
        assert len(names) == len(group)
        whole_names[f"{group.tag} {permission}"] = {f"/{name.replace('~', node, 1)}" for name in names}
    return whole_names


def in_the_graph(node: Any) -> dict[str, set[str]]:
    """Whole names of what a node offers, as the middleware tells others; those of its actions by the action's name."""
    who = node.get_name(), node.get_namespace()

    def seen(ask: Any) -> set[str]:
        return {name for name, _ in ask(*who) if "/_action/" not in name}

    return {
        "actions execute": {name for name, _ in actions_of(node)},
        "services reply": seen(node.get_service_names_and_types_by_node),
        "topics subscribe": seen(node.get_subscriber_names_and_types_by_node),
        "topics publish": seen(node.get_publisher_names_and_types_by_node),
    }


def made_by(node: Any) -> dict[str, set[str]]:
    """The same as rclpy knows it at once, without its actions and what is made below it."""
    return {
        "services reply": {service.service_name for service in node.services},
        "topics subscribe": {subscription.topic_name for subscription in node.subscriptions},
        "topics publish": {publisher.topic_name for publisher in node.publishers} | {"/rosout"},
    }


@pytest.fixture(scope="module")
def offered(new_arm_name: Any) -> dict[str, set[str]]:
    """All that a front can offer: six joints, hence the full node's interfaces, and a gripper."""
    arm = load_arm("mock", overrides={"name": new_arm_name(), "gripper": {"hook": "simulated"}})
    with node_of(arm) as node:

        def missing() -> list[str]:
            found = in_the_graph(node)
            return [
                name for kind, names in made_by(node).items() for name in names - found[kind] if "/_action/" not in name
            ]

        until(lambda: not missing(), "all that the front makes in the graph", PATIENCE_S)
        return in_the_graph(node)


@PAGES
@pytest.mark.parametrize("kind", KINDS)
def test_the_front_may_do_what_it_offers_and_no_more(page: str, kind: str, offered: dict[str, set[str]]) -> None:
    assert allowed(page, "/rtarm/front", NODE)[kind] == offered[kind]


@PAGES
def test_moveit_may_ask_for_what_the_front_offers(page: str, offered: dict[str, set[str]]) -> None:
    asked = allowed(page, "/rtarm/moveit", "move_group")
    assert asked.keys() == {"actions call", "topics subscribe"}
    assert asked["actions call"] < offered["actions execute"]
    assert asked["topics subscribe"] < offered["topics publish"]
