"""Every option that a Darknet reads is applied, harmless, or refused: nothing is passed over."""

from pathlib import Path

import pytest

from droptrack.errors import DroptrackError
from droptrack.network.bundled import find_network
from droptrack.network.cfg_options import APPLIED, HARMLESS, NEEDED, ONLY
from droptrack.network.darknet_cfg import parse_cfg, pool_options, read_cfg

# what src/parser.c asks for, section by section: of pjreddie/darknet and of AlexeyAB/darknet
GENERIC = """truth onlyforward stopbackward dontsave dontload numload dontloadscales learning_rate
smooth show_receptive_field clip dont_update burnin_update train_only_bn"""
READ = {
    "net": """batch learning_rate momentum decay subdivisions time_steps notruth random adam B1 B2
        eps height width channels inputs max_crop min_crop max_ratio min_ratio center clip angle
        aspect saturation exposure hue policy burn_in power step scale steps scales gamma
        max_batches learning_rate_min sgdr_cycle sgdr_mult track augment_speed
        sequential_subdivisions try_fix_nan weights_reject_freq equidistant_point
        badlabels_rejection_percentage num_sigmas_reject_badlabels ema_alpha use_cuda_graph
        loss_scale dynamic_minibatch optimized_memory workspace_size_limit_MB flip blur
        gaussian_noise mixup cutmix mosaic letter_box mosaic_bound contrastive
        contrastive_jit_flip contrastive_color unsupervised label_smooth_eps resize_step attention
        adversarial_lr max_chart_loss seq_scales""",
    "convolutional": f"""filters size stride pad padding groups activation batch_normalize binary
        xnor flipped dot stride_x stride_y dilation antialiasing assisted_excitation share_index cbn
        bin_output sway rotate stretch stretch_sway angle grad_centr reverse coordconv stream
        wait_stream {GENERIC}""",
    "maxpool": f"""stride size padding stride_x stride_y maxpool_depth out_channels antialiasing
        maxpool_zero_nonmax {GENERIC}""",
    "upsample": f"stride scale {GENERIC}",
    "route": f"layers groups group_id stream wait_stream {GENERIC}",
    "shortcut": f"from activation alpha beta weights_type weights_normalization {GENERIC}",
    "yolo": f"""classes num mask max jitter ignore_thresh truth_thresh random map anchors
        show_details max_delta counters_per_class label_smooth_eps scale_x_y objectness_smooth
        new_coords iou_normalizer obj_normalizer cls_normalizer delta_normalizer iou_loss
        iou_thresh_kind beta_nms nms_kind resize focal_loss iou_thresh track_history_size sim_thresh
        dets_for_track dets_for_show track_ciou_norm embedding_layer {GENERIC}""",
}
# of those that change what is computed: a value that is refused
REFUSED = {
    "net": {"channels": "1"},
    "convolutional": {
        **dict.fromkeys(("xnor", "binary", "antialiasing", "bin_output", "flipped", "cbn"), "1"),
        **dict.fromkeys(("sway", "rotate", "stretch", "stretch_sway", "coordconv", "reverse"), "1"),
        **{"dilation": "2", "share_index": "-4", "stride_x": "1", "stride_y": "3"},
    },
    "maxpool": {
        **{"maxpool_depth": "1", "antialiasing": "1", "maxpool_zero_nonmax": "1"},
        **{"stride_x": "1", "stride_y": "1"},
    },
    "upsample": {"scale": "2"},
    "route": {},
    "shortcut": {
        **{"activation": "leaky", "weights_type": "per_channel", "alpha": "0.5", "beta": "2"},
    },
    "yolo": {"map": "coco.map", "nms_threshold": "0.4"},
}
LOADING = {"dontload": "1", "dontloadscales": "1", "dontsave": "1", "numload": "8"}

SECTIONS = {
    "net": "width=64\nheight=64\nchannels=3",
    "convolutional": "filters=8\nsize=3\nstride=2\npad=1\nactivation=leaky",
    "maxpool": "size=2\nstride=2",
    "upsample": "stride=2",
    "shortcut": "from=-3\nactivation=linear",
    "route": "layers=-1",
    "yolo": "mask=0\nanchors=8,8\nclasses=1\nnum=1",
}
ORDER = ("net", "convolutional", "maxpool", "upsample", "shortcut", "route", "last", "yolo")


def network(kind: str = "", options: str = "") -> str:
    """A network with every kind of section; `options` are added to the one of a kind."""
    parts = []
    for one in ORDER:
        body = SECTIONS.get(one, "filters=6\nsize=1\nstride=1\nactivation=linear")
        name = "convolutional" if one == "last" else one
        parts.append(f"[{name}]\n{body}\n" + (f"{options}\n" if one == kind else ""))
    return "".join(parts)


def line_of(text: str, option: str) -> int:
    """The last line, from 1, that is as given."""
    lines = text.splitlines()
    return len(lines) - lines[::-1].index(option)


def test_a_network_with_all_sections_is_read() -> None:
    assert len(parse_cfg(network(), Path("n.cfg")).layers) == 7


@pytest.mark.parametrize("kind", READ)
def test_every_option_of_both_darknets_is_decided(kind: str) -> None:
    refused = {**REFUSED[kind], **({} if kind == "net" else LOADING)}
    for option in READ[kind].split():
        places = [option in APPLIED[kind], option in HARMLESS[kind], option in refused]
        assert sum(places) == 1, option
    assert set(ONLY[kind]) <= set(refused)


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [
        (kind, key, value)
        for kind, options in REFUSED.items()
        for key, value in {**options, **({} if kind == "net" else LOADING)}.items()
    ],
)
def test_what_changes_the_result_is_refused_with_its_line(kind: str, key: str, value: str) -> None:
    own = SECTIONS[kind].split("\n")
    there = next((line for line in own if line.startswith(f"{key}=")), None)
    text = network(kind, f"{key}={value}")
    if there is not None:
        text = network().replace(f"[{kind}]\n" + SECTIONS[kind], f"[{kind}]\n" + SECTIONS[
            kind
        ].replace(there, f"{key}={value}"))  # fmt: skip
    with pytest.raises(DroptrackError, match=f"n.cfg:{line_of(text, f'{key}={value}')}: {key}="):
        parse_cfg(text, Path("n.cfg"))


@pytest.mark.parametrize("kind", READ)
def test_what_changes_nothing_is_taken(kind: str) -> None:
    for key in sorted(HARMLESS[kind]):
        parse_cfg(network(kind, f"{key}=1"), Path("n.cfg"))
    for key, value in ONLY[kind].items():
        parse_cfg(network(kind, f"{key}={value}"), Path("n.cfg"))
    if kind in ("convolutional", "maxpool"):
        parse_cfg(network(kind, "stride_x=2\nstride_y=2"), Path("n.cfg"))


def test_dilation_of_a_single_pixel_is_none() -> None:
    """As in AlexeyAB's parser."""
    parse_cfg(network("last", "dilation=2"), Path("n.cfg"))


def test_a_misspelt_option_is_refused() -> None:
    text = network("convolutional", "activaton=mish")
    said = f"n.cfg:{line_of(text, 'activaton=mish')}: .*; is activation= meant"
    with pytest.raises(DroptrackError, match=said):
        parse_cfg(text, Path("n.cfg"))
    parse_cfg(network("convolutional", "comment=first layer"), Path("n.cfg"))


def test_an_option_given_twice_is_refused() -> None:
    """Darknet takes the first, OpenCV the last."""
    text = network("convolutional", "size=1")
    with pytest.raises(DroptrackError, match=r"n\.cfg:11: size=1, but line 7 has size=3"):
        parse_cfg(text, Path("n.cfg"))
    parse_cfg(network("convolutional", "size=3"), Path("n.cfg"))


@pytest.mark.parametrize("kind", NEEDED)
def test_what_darknet_and_the_engines_take_for_granted_must_be_written(kind: str) -> None:
    for key in NEEDED[kind]:
        body = "\n".join(x for x in SECTIONS[kind].split("\n") if not x.startswith(f"{key}="))
        text = network().replace(f"[{kind}]\n{SECTIONS[kind]}", f"[{kind}]\n{body}", 1)
        with pytest.raises(DroptrackError, match=rf"\[{kind}\] needs {key}="):
            parse_cfg(text, Path("n.cfg"))


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("from=-3", "from=-3,-1", r"line 16: \[shortcut\] from=-3,-1 adds several layers"),
        ("filters=8", "filters=1000000000", "too many"),
        ("filters=8", "filters=9223372036854775808", "should be a whole number"),
        ("filters=8", "filters=0", "should be 1 or more"),
        ("filters=8", "filters=nan", "should be finite"),
        ("filters=8", "filters=8\ngroups=0", "should be 1 or more"),
        ("filters=8", "filters=8\ngroups=2", "groups=2 does not divide"),
        ("layers=-1", "layers=-1\ngroups=3", "group 0 of 3 is not there"),
        ("layers=-1", "layers=-1\ngroups=2\ngroup_id=2", "group 2 of 2 is not there"),
        ("width=64", "width=32e40", "should be a whole number"),
        ("width=64", "width=1600000000", "too many"),
        ("num=1", "new_coords=1", "new_coords=1 is not supported"),
        ("num=1", "num=3", "num=3, but anchors= has 1"),
        ("anchors=8,8", "anchors=8,0", "sizes above 0"),
        ("anchors=8,8", "anchors=8,inf", "should be finite"),
    ],
)
def test_networks_that_cannot_be_are_refused(old: str, new: str, problem: str) -> None:
    with pytest.raises(DroptrackError, match=problem):
        parse_cfg(network().replace(old, new, 1), Path("n.cfg"))


def test_a_mark_before_the_text_is_no_part_of_it(tmp_path: Path) -> None:
    (tmp_path / "n.cfg").write_bytes(b"\xef\xbb\xbf" + network().encode())
    assert read_cfg(tmp_path / "n.cfg").width == 64


def test_padding_of_a_pool_is_its_size_less_one() -> None:
    assert pool_options(parse_cfg(network(), Path("n.cfg")).layers[1]) == (2, 2, 1)


def test_a_letter_box_is_trained_by_darknet_but_refused_for_finding(tmp_path: Path) -> None:
    """The input has the frames' shape here: there is nothing to fill with grey."""
    path = tmp_path / "n.cfg"
    path.write_text(network("net", "letter_box=1"))
    (tmp_path / "n.weights").touch()
    assert read_cfg(path).width == 64
    with pytest.raises(DroptrackError, match=r"n\.cfg:1: letter_box=1"):
        find_network(tmp_path / "n.weights", path)
