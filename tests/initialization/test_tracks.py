"""Who is where: people followed from frame to frame, chosen, and taken from other systems' files."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from hfb.errors import InputError
from hfb.io.clip import PersonChoice
from hfb.io.media.images.image_io import read_picture_srgb
from hfb.tracking.gap_looks import look_into_gaps
from hfb.tracking.tracks import (
    ClipFrames,
    Track,
    choose_everyone,
    choose_track,
    find_tracks,
    keep_person,
    read_track,
    read_track_names,
    surroundings,
)
from tests.shared import SHARED_DATA

HEIGHT, WIDTH = 90, 160
PLATE = np.full((HEIGHT, WIDTH, 3), 0.4, np.float32)


def frames(*people: list[tuple[int, int] | None]) -> list[np.ndarray]:
    """Each person is a list of (left, height) per frame, feet at row 80; None where away."""
    rng = np.random.default_rng(1)
    out = []
    for number in range(len(people[0])):
        picture = PLATE + rng.normal(0, 0.005, PLATE.shape)
        for person in people:
            if (here := person[number]) is not None:
                picture[80 - here[1] : 80, here[0] : here[0] + 14] = (0.9, 0.2, 0.3)
        out.append(picture.astype(np.float32))
    return out


WALKS: list[tuple[int, int] | None] = [(10 + 4 * n, 50) for n in range(10)]
STANDS: list[tuple[int, int] | None] = [(120, 30)] * 10


def test_everyone_is_followed_and_the_largest_is_chosen() -> None:
    told: list[int] = []
    tracks = find_tracks(frames(WALKS, STANDS), PLATE, told.append)
    assert told == list(range(1, 11))
    assert len(tracks) == 2
    largest = choose_track(tracks, PersonChoice())
    assert largest.present.all()
    assert np.allclose(largest.boxes[5], [30, 30, 44, 80], atol=3)
    boxed = choose_track(tracks, PersonChoice(box=(110, 45, 140, 85), frame=3))
    assert np.allclose(boxed.boxes[5], [120, 50, 134, 80], atol=3)
    with pytest.raises(InputError, match="nobody was seen in the box of frame 3; seen there: person 1, person 2"):
        choose_track(tracks, PersonChoice(box=(80, 1, 90, 9), frame=3))
    with pytest.raises(InputError, match="past the clip's last frame 9"):
        choose_track(tracks, PersonChoice(box=(80, 1, 90, 9), frame=10))


def in_pieces(walk: list[tuple[int, int] | None], rows: slice) -> list[np.ndarray]:
    """Somebody whose clothes look like the background in some rows."""
    out = frames(walk)
    for picture in out:
        picture[rows] = PLATE[rows]
    return out


def faint(frame: np.ndarray, plate: np.ndarray) -> np.ndarray:
    """What a matting network sees of `WALKS`: also where nothing differs enough for `changed_pixels`."""
    seen = (np.abs(frame - plate).max(-1) > 0.03).astype(np.float32)
    columns = seen.any(0)
    first, last = np.flatnonzero(seen.any(1))[[0, -1]]
    seen[first : last + 1, columns] = np.maximum(seen[first : last + 1, columns], 0.3)
    return seen


def sharp(frame: np.ndarray, plate: np.ndarray) -> np.ndarray:
    """A network that sees two people where there are two."""
    return (np.abs(frame - plate).max(-1) > 0.03).astype(np.float32)


@pytest.mark.parametrize("rows", [slice(48, 62), slice(40, 58), slice(56, 68)])
def test_pieces_of_one_person_are_one(rows: slice) -> None:
    """Black shorts before a dark hedge: the box is the whole person's, and no frame is a gap."""
    (track,) = find_tracks(in_pieces(WALKS, rows), PLATE, alpha=faint)
    assert track.present.all()
    assert np.allclose(track.boxes[5], [30, 30, 44, 80], atol=3)


def test_one_above_another_are_two() -> None:
    """Somebody on a roof above somebody on the ground, as near as the pieces of one."""
    assert len(find_tracks(in_pieces(WALKS, slice(48, 62)), PLATE, alpha=sharp)) == 2


def test_side_by_side_and_behind_are_not_asked_about() -> None:
    """No look at all: the pieces of one person lie above each other."""

    def asked(*_: np.ndarray) -> np.ndarray:
        raise AssertionError

    beside: list[tuple[int, int] | None] = [(34 + 4 * n, 48) for n in range(10)]
    assert len(find_tracks(frames(WALKS, beside), PLATE, alpha=asked)) == 2
    assert len(find_tracks(frames(WALKS, STANDS), PLATE, alpha=asked)) == 2


def test_two_people_slantwise_are_two() -> None:
    """An arm over somebody smaller: each row between them holds a part of both."""
    pictures = frames([None] * 4)
    for picture in pictures:
        for rows, columns in (
            (slice(10, 60), slice(40, 54)),
            (slice(10, 16), slice(54, 82)),
            (slice(28, 82), slice(67, 81)),
        ):
            picture[rows, columns] = (0.9, 0.2, 0.3)
    assert len(find_tracks(pictures, PLATE, alpha=sharp)) == 2


def test_a_fragment_does_not_take_over_the_person() -> None:
    """A reflection comes off the feet in one frame and is one with somebody who crouches in the next."""
    pictures = frames([None] * 6)
    for number, picture in enumerate(pictures):
        top, bottom = (20, 80) if number >= 4 else (10, 55)
        picture[top:bottom, 60:74] = (0.9, 0.2, 0.3)
        if number == 3:
            picture[68:80, 60:74] = (0.9, 0.2, 0.3)
    assert choose_track(find_tracks(pictures, PLATE, alpha=sharp), PersonChoice()).present.all()


def test_real_people_are_followed_whole() -> None:
    """The clip of a squat: a reflection below the feet took the person's place (4 frames of 20 missed)."""
    folder = SHARED_DATA / "opencap_squat"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    pictures = [frame for n, frame in enumerate(video(folder / "cam0_f060-299.mp4")) if n % 12 == 0]
    tracks = find_tracks(pictures, read_picture_srgb(folder / "cam0_plate.png"))
    track = choose_track(tracks, PersonChoice())
    assert track.present.all()
    assert (track.boxes[:, 1] < 700).all()  # with the head


def test_real_people_in_pieces_and_above_each_other() -> None:
    """A woman whose hips hardly differ from the hedge stays whole; the man on the roof above her stays another."""
    folder = SHARED_DATA / "sports2d_park"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    plate = read_picture_srgb(folder / "plate.png")
    pictures = []
    for number, frame in enumerate(video(folder / "demo.mp4")):
        if number in (90, 97, 104, 118, 125, 132, 139):
            hips = slice(660, 750)
            frame[hips] = plate[hips] + 0.15 * (frame[hips] - plate[hips])
            pictures.append(frame)
        if number > 139:
            break
    tracks = find_tracks(pictures, plate)
    assert [int(track.present.sum()) for track in tracks] == [7, 7]
    woman = tracks[0] if np.nanmean(tracks[0].boxes[:, 3]) > np.nanmean(tracks[1].boxes[:, 3]) else tracks[1]
    heights = woman.boxes[:, 3] - woman.boxes[:, 1]
    assert (heights > 400).all()
    assert (heights < 520).all()


def dim(people: list[tuple[int, int] | None], brighter: dict[int, float]) -> list[np.ndarray]:
    """Somebody who hardly stands out; some frames are exposed otherwise than the plate."""
    out = []
    for number, picture in enumerate(frames([None] * len(people))):
        if (here := people[number]) is not None:
            picture[80 - here[1] : 80, here[0] : here[0] + 14] = (0.47, 0.4, 0.4)
        out.append((picture * brighter.get(number, 1.0)).astype(np.float32))
    return out


def looked_into(pictures: list[np.ndarray], whom: PersonChoice | None = None) -> tuple[Track, Track, int]:
    """(as tracked, with a second look, number of looks)."""
    tracks, looks = find_tracks(pictures, PLATE), [0]
    track = choose_track(tracks, whom or PersonChoice())
    rest = [one for one in tracks if one.name != track.name]
    again = look_into_gaps(track, rest, lambda number: pictures[number], PLATE, sharp, looks.append)
    return track, again, looks[-1]


def test_frames_in_another_exposure_are_no_gaps() -> None:
    """All of such a frame differs from the plate, and nobody stands out; the person is there all the same."""
    track, again, looks = looked_into(dim(WALKS, {3: 1.1, 4: 0.92, 9: 1.1}))
    assert track.present.tolist() == [number not in (3, 4, 9) for number in range(10)]
    assert again.present.all()
    assert looks == 3
    assert np.allclose(again.boxes[4], [26, 30, 40, 80], atol=1)
    assert again.areas[3] == pytest.approx(14 * 50, rel=0.1)
    seen = track.present
    assert np.array_equal(again.boxes[seen], track.boxes[seen])


def test_who_is_away_or_cut_off_stays_a_gap() -> None:
    """A few looks at each end of an absence, and none where nobody is missed."""
    leaves = [*WALKS[:4], *[None] * 30, *WALKS[4:]]
    track, again, looks = looked_into(dim(leaves, {}))
    assert np.array_equal(again.present, track.present)
    assert looks == 4
    out: list[tuple[int, int] | None] = [(106 + 10 * n, 50) for n in range(5)]  # the last one touches the frame's side
    assert looked_into(dim(out, {4: 1.1}))[1].present.tolist() == [True] * 4 + [False]
    assert looked_into(dim(WALKS, {}))[2] == 0


def test_nobody_else_stands_in() -> None:
    """In a frame where one is hidden, a second person of the same size who is near is not taken for the first."""
    first = [(20, 50)] * 4 + [None] * 2 + [(20, 50)] * 4
    second: list[tuple[int, int] | None] = [(44, 50)] * 10
    pictures = [np.minimum(one, other) for one, other in zip(dim(first, {}), dim(second, {}), strict=True)]
    for number, picture in enumerate(pictures):
        for here in (first[number], second[number]):
            if here is not None:
                picture[80 - here[1] : 80, here[0] : here[0] + 14] = (0.47, 0.4, 0.4)
        if number in (4, 5):
            picture *= 1.1
    track, again, _ = looked_into(pictures, PersonChoice(box=(18, 30, 36, 80), frame=0))
    assert not track.present[4:6].any()
    assert not again.present[4:6].any()


def test_real_people_in_frames_of_another_exposure() -> None:
    """The park in frames that are brighter or darker than the plate: nobody in full view is a gap."""
    folder = SHARED_DATA / "sports2d_park"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    plate, pictures = read_picture_srgb(folder / "plate.png"), []
    for number, frame in enumerate(video(folder / "demo.mp4")):
        if number > 138:
            break
        if number >= 90 and number % 3 == 0:
            pictures.append((frame * (0.9 if len(pictures) % 3 == 1 else 1)).clip(0, 1).astype(np.float32))
    tracks = find_tracks(pictures, plate)
    track = choose_track(tracks, PersonChoice())
    rest = [one for one in tracks if one.name != track.name]
    again = look_into_gaps(track, rest, lambda number: pictures[number], plate)
    assert track.present.sum() == 15
    assert again.present.sum() == 17
    heights = (again.boxes[:, 3] - again.boxes[:, 1])[~track.present]
    assert (np.abs(heights / np.nanmedian(track.boxes[:, 3] - track.boxes[:, 1]) - 1) < 0.2).all()


def video(path: Path) -> Iterator[np.ndarray]:
    reader = cv2.VideoCapture(str(path))
    while (read := reader.read())[0]:
        yield read[1][..., ::-1].astype(np.float32) / 255


def test_who_leaves_is_absent() -> None:
    leaves = [*WALKS[:4], None, None, None, *WALKS[7:]]
    tracks = find_tracks(frames(leaves), PLATE)
    assert len(tracks) == 1
    assert tracks[0].present.tolist() == [True] * 4 + [False] * 3 + [True] * 3


def test_who_comes_back_elsewhere_is_taken_for_the_same_unless_a_box_says_who() -> None:
    first, later = [(10, 50)] * 5 + [None] * 5, [None] * 6 + [(140, 22)] * 4
    tracks = find_tracks(frames(first, later), PLATE)
    assert len(tracks) == 2
    assert choose_track(tracks, PersonChoice()).present.tolist() == [True] * 5 + [False] + [True] * 4
    assert choose_track(tracks, PersonChoice(box=(0, 20, 30, 90))).present.tolist() == [True] * 5 + [False] * 5


def test_nobody() -> None:
    assert find_tracks(frames([None] * 3), PLATE) == ()
    with pytest.raises(InputError, match="nobody was seen in any frame"):
        choose_track((), PersonChoice())


def test_a_matte_keeps_one_person() -> None:
    matte = np.zeros((HEIGHT, WIDTH), np.float32)
    matte[30:80, 30:44] = 1
    matte[50:80, 120:134] = 0.8
    kept = keep_person(matte, np.array([30.0, 30, 44, 80]))
    assert np.array_equal(kept[:, :100], matte[:, :100])
    assert not kept[:, 100:].any()
    with pytest.raises(InputError, match="no person was found"):
        keep_person(matte, np.array([70.0, 30, 90, 80]))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "frame,id,left,top,width,height\n0,3,10,20,30,40\n2,3,12,20,30,40\n2,7,50,20,30,40\n"),
        ("b.csv", "Frame, track_id, x1, y1, x2, y2\n0,3.0,10,20,40,60\n2,3,12,20,42,60\n2,7,50,20,80,60\n"),
        ("d.csv", "frame;id;left;top;width;height\n0;3;10;20;30;40\n2;3;12;20;30;40\n2;7;50;20;30;40\n"),
        (
            "e.txt",
            "frame\tid\tleft\ttop\twidth\theight\n0\t3\t10\t20\t30\t40\n2\t3\t12\t20\t30\t40\n2\t7\t5\t2\t3\t4\n",
        ),
        ("mot.txt", "1,3,10,20,30,40,1,-1,-1,-1\n3,3,12,20,30,40,1,-1,-1,-1\n3,7,50,20,30,40,1,-1,-1,-1\n"),
    ],
)
def test_tracks_of_other_systems(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    track = read_track(tmp_path / name, 3, ClipFrames(4))
    assert track.present.tolist() == [True, False, True, False]
    assert np.allclose(track.boxes[[0, 2]], [[10, 20, 40, 60], [12, 20, 42, 60]])
    with pytest.raises(InputError, match=r"holds 2 people; choose one with person.id: 3, 7"):
        read_track(tmp_path / name, None, ClipFrames(4))
    with pytest.raises(InputError, match="has no track 5"):
        read_track(tmp_path / name, 5, ClipFrames(4))
    with pytest.raises(InputError, match="no box in the clip's 2 frames"):
        read_track(tmp_path / name, "7", ClipFrames(2))


def test_people_of_long_names_are_told_shortly(tmp_path: Path) -> None:
    names = [str(number) + "x" * 5000 for number in range(3)]
    rows = "".join(f"0,{name},1,2,3,4\n" for name in names)
    (tmp_path / "a.csv").write_text(f"frame,id,left,top,width,height\n{rows}")
    for wanted in (None, "y" * 5000):
        with pytest.raises(InputError) as told:
            read_track(tmp_path / "a.csv", wanted, ClipFrames(4))
        assert len(str(told.value)) - len(str(tmp_path)) < 300


def test_tracks_as_arrays(tmp_path: Path) -> None:
    box = np.array([[1.0, 2, 3, 4], [5, 6, 7, 8]])
    np.savez(tmp_path / "t.npz", frame=[1, 2], id=["a", "a"], box=box)
    track = read_track(tmp_path / "t.npz", None, ClipFrames(3))
    assert isinstance(track, Track)
    assert np.allclose(track.boxes[1:], box)


@pytest.mark.parametrize(
    "content",
    [
        "",
        "frame,id\n0,1\n",
        "frame,id,left,top,width,height\n0,1,a,b,c,d\n",
        "frame,id,left,top,width,height\n0,1,.2,.1,.3,.6\n",  # shares of the picture
        "1,2\n",
    ],
)
def test_what_is_no_file_of_tracks(tmp_path: Path, content: str) -> None:
    (tmp_path / "t.csv").write_text(content)
    with pytest.raises(InputError, match="is no file of tracks"):
        read_track(tmp_path / "t.csv", None, ClipFrames(3))
    with pytest.raises(InputError, match="no such file"):
        read_track(tmp_path / "missing.csv", None, ClipFrames(3))


def test_everyone_can_be_chosen_again() -> None:
    nan = np.full(4, np.nan)
    one = np.array([[0, 0, 10, 30]] * 6, float)
    other = np.array([[5, 0, 15, 30], [5, 0, 15, 30], *[[50 + step, 0, 60 + step, 30] for step in range(3)], nan])
    ghost = np.array([nan, nan, nan, [90, 0, 99, 9], nan, nan])
    tracks = [Track(name, boxes, boxes[:, 2]) for name, boxes in (("a", one), ("b", other), ("c", ghost))]
    chosen = choose_everyone(tracks)
    assert [track.name for track, _ in chosen] == ["a", "b"]  # c is seen once
    assert [choose_track(tracks, choice).name for _, choice in chosen] == ["a", "b"]
    assert chosen[1][1].frame == 2  # where nobody stands in front
    with pytest.raises(InputError, match="nobody"):
        choose_everyone(tracks[2:])


def test_names_in_a_file_of_tracks(tmp_path: Path) -> None:
    path = tmp_path / "tracks.csv"
    path.write_text("frame,id,left,top,right,bottom\n0,10,0,0,5,9\n1,9,0,0,5,9\n7,8,0,0,5,9\n")
    assert read_track_names(path, ClipFrames(3)) == ("9", "10")
    with pytest.raises(InputError, match="no box"):
        read_track_names(path, ClipFrames(0))


def test_surroundings_stay_in_the_picture() -> None:
    rows, columns = surroundings(np.array([2.0, 10.0, 22.0, 50.0]), 55, 100)
    assert (rows.start, rows.stop, columns.start, columns.stop) == (0, 55, 0, 34)
    rows, columns = surroundings(np.array([120.0, 60.0, 150.0, 90.0]), 55, 100)  # somebody who has left
    assert (rows.start, rows.stop, columns.start, columns.stop) == (51, 55, 100, 100)


def test_tracks_count_the_frames_of_the_video(tmp_path: Path) -> None:
    path = tmp_path / "tracks.csv"
    rows = [f"{frame},1,{10 * frame},0,{10 * frame + 5},9" for frame in range(12)]
    path.write_text("\n".join(["frame,id,left,top,right,bottom", *rows]))
    boxes = read_track(path, None, ClipFrames(3, first=4, average=2)).boxes
    assert boxes.tolist() == [[40, 0, 55, 9], [60, 0, 75, 9], [80, 0, 95, 9]]
    with pytest.raises(InputError, match=r"3 frames \(from frame 12 of the video on\)"):
        read_track(path, None, ClipFrames(3, first=12))


def test_boxes_outside_of_the_picture_are_of_nobody_seen(tmp_path: Path) -> None:
    path = tmp_path / "tracks.csv"
    boxes = ("-30,5,-2,20", "120,5,150,20", "5,60,20,90", "5,5,5,20", "-3,5,12,20")
    path.write_text("\n".join(["frame,id,left,top,right,bottom", *(f"{n},1,{box}" for n, box in enumerate(boxes))]))
    track = read_track(path, None, ClipFrames(5, height=55, width=100))
    assert track.present.tolist() == [False, False, False, False, True]


def test_a_box_chooses_the_one_it_was_drawn_around() -> None:
    adult, dog = (
        Track(name, np.array([box], float), np.ones(1))
        for name, box in (("adult", (100, 50, 220, 400)), ("dog", (225, 300, 290, 400)))
    )
    assert choose_track([adult, dog], PersonChoice(box=(105, 55, 295, 405), frame=0)).name == "adult"
