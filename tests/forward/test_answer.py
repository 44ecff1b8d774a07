import numpy as np

from zoedepth.forward.answer import Answer, in_groups


def test_photos_of_one_size_go_together_and_come_back_in_order() -> None:
    sizes = [(32, 32), (32, 64), (32, 32), (32, 32)]
    photos = [(np.full((1, 1, 3), number, np.uint8), size) for number, size in enumerate(sizes)]
    asked = []

    def predict(images: list[np.ndarray], size: tuple[int, int]) -> list[Answer]:
        asked.append(([int(image[0, 0, 0]) for image in images], size))
        return [Answer(image[..., 0].astype(np.float32), None, 0, None) for image in images]

    answers = in_groups(predict, photos, 2)
    assert asked == [([0, 2], (32, 32)), ([3], (32, 32)), ([1], (32, 64))]
    assert [answer.depth.item() for answer in answers] == [0, 1, 2, 3]
