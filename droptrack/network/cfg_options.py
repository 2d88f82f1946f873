"""Every option of a ``.cfg`` that a Darknet reads, and what becomes of it here.

Options are those of the parsers of J. Redmon's Darknet and of AlexeyAB's (``src/parser.c``), of the
layers that are known here. Each is applied by every engine, or harmless, since it only concerns
training, drawing or scheduling; or it changes what the network computes in a way that the engines
do not have: then only the value is taken at which it changes nothing.
"""

from collections.abc import Mapping
from difflib import get_close_matches

ANY_LAYER = frozenset(
    """clip truth onlyforward stopbackward dont_update burnin_update train_only_bn learning_rate
    smooth show_receptive_field stream wait_stream""".split()
)
APPLIED = {
    "net": frozenset("width height letter_box".split()),  # letter_box=1: see `find_network`
    "convolutional": frozenset(
        "filters size stride pad padding groups activation batch_normalize".split()
    ),
    "maxpool": frozenset("size stride padding".split()),
    "upsample": frozenset("stride".split()),
    "route": frozenset("layers groups group_id".split()),
    "shortcut": frozenset("from".split()),
    "yolo": frozenset(
        "mask anchors classes num scale_x_y new_coords".split()
    ),  # new_coords=1: see `yolo_heads`
}
HARMLESS = {
    "net": frozenset(
        """batch subdivisions max_batches learning_rate learning_rate_min sgdr_cycle sgdr_mult
        momentum decay time_steps track augment_speed sequential_subdivisions try_fix_nan
        weights_reject_freq equidistant_point badlabels_rejection_percentage
        num_sigmas_reject_badlabels ema_alpha use_cuda_graph loss_scale dynamic_minibatch
        optimized_memory workspace_size_limit_MB adam B1 B2 eps inputs max_crop min_crop max_ratio
        min_ratio center clip flip blur gaussian_noise mixup cutmix mosaic mosaic_bound contrastive
        contrastive_jit_flip contrastive_color unsupervised label_smooth_eps resize_step attention
        adversarial_lr max_chart_loss angle aspect saturation exposure hue power policy burn_in step
        scale steps scales seq_scales gamma notruth random""".split()
    ),
    "convolutional": ANY_LAYER | frozenset("assisted_excitation dot angle grad_centr".split()),
    "maxpool": ANY_LAYER | frozenset("out_channels".split()),  # of maxpool_depth=1
    "upsample": ANY_LAYER,
    "route": ANY_LAYER,
    "shortcut": ANY_LAYER | frozenset("weights_normalization".split()),  # of weights_type=
    "yolo": ANY_LAYER
    | frozenset(
        """max show_details max_delta counters_per_class label_smooth_eps objectness_smooth
        iou_normalizer obj_normalizer cls_normalizer delta_normalizer iou_loss iou_thresh_kind
        beta_nms nms_kind jitter resize focal_loss ignore_thresh truth_thresh iou_thresh random
        track_history_size sim_thresh dets_for_track dets_for_show track_ciou_norm embedding_layer
        thresh""".split()
    ),
}
# values at which an option changes nothing; the weights of a layer are always read, all of them
LOADING = dict.fromkeys(("dontload", "dontloadscales", "dontsave", "numload"), "0")
ONLY = {
    "net": {"channels": "3"},
    "convolutional": {
        **dict.fromkeys(("antialiasing", "binary", "xnor", "bin_output", "cbn", "flipped"), "0"),
        **dict.fromkeys(("sway", "rotate", "stretch", "stretch_sway", "coordconv", "reverse"), "0"),
        "dilation": "1",
        "share_index": "-1000000000",
        **LOADING,
    },
    "maxpool": {"maxpool_depth": "0", "antialiasing": "0", "maxpool_zero_nonmax": "0", **LOADING},
    "upsample": {"scale": "1", **LOADING},
    "route": LOADING,
    "shortcut": {
        "activation": "linear",
        "weights_type": "none",
        "alpha": "1",
        "beta": "1",
        **LOADING,
    },
    "yolo": {"nms_threshold": "0", **LOADING},  # the first is OpenCV's own
}
# what Darknet and the engines take for granted where it is not written is not the same
NEEDED = {
    "convolutional": ("filters", "size", "activation"),
    "maxpool": ("size", "stride"),
    "upsample": ("stride",),
}
READ_TOO = ("map",)  # a file of classes
MIN_ALIKE = 0.75  # of a word that is taken for a misspelt one
BY_AXIS = ("stride_x", "stride_y")  # as `stride` only


def refusal(kind: str, key: str, options: Mapping[str, str]) -> str | None:
    """Why an option of a section cannot be taken as it is written; None where it can.

    >>> refusal("convolutional", "xnor", {"xnor": "1"})
    'changes what the network computes, which no engine here does; only xnor=0 is supported'
    >>> refusal("net", "mosaic", {"mosaic": "1"})
    """
    if key == "batch_normalize" and not any(_same(options[key], yes_no) for yes_no in "01"):
        return "should be 0 or 1"
    if kind not in APPLIED or key in APPLIED[kind] or key in HARMLESS[kind]:
        return None  # unknown kinds are refused elsewhere
    value = options[key]
    wanted = ONLY[kind].get(key)
    if key in BY_AXIS and kind in ("convolutional", "maxpool"):
        wanted = options.get("stride", "1")
    if key == "dilation" and _same(options.get("size", ""), "1"):
        return None  # as Darknet has it
    if wanted is None and key in READ_TOO:
        return "changes what the network computes, which no engine here does; leave it out"
    if wanted is None:  # no Darknet reads it either
        alike = get_close_matches(key, {*APPLIED[kind], *ONLY[kind]}, 1, MIN_ALIKE)
        return f"is no option of [{kind}]; is {alike[0]}= meant?" if alike else None
    if _same(value, wanted):
        return None
    return (
        "changes what the network computes, which no engine here does; only "
        f"{key}={wanted} is supported"
    )


def _same(value: str, wanted: str) -> bool:
    try:
        return float(value) == float(wanted)
    except ValueError:
        return value.strip() == wanted
