"""What the tables mean, written by hand after they were read, and the commands that made them."""

_TEXT = """
```
refcodec train PHOTOGRAPHS -o caliterra-0.002 --rate 0.002 --steps 2000 --size 200 --threads 1
refcodec encode caliterra-0.002 -o caliterra-0.002.c3gs
python -m benchmarks.lengths run FOLDER --question weights --scenes caliterra-0.002.c3gs playbot-0.002.c3gs
python -m benchmarks.lengths run FOLDER --question smallest --scenes playbot-0.002.c3gs
python -m benchmarks.lengths run FOLDER --question contexts --scenes caliterra-0.002.c3gs
refcodec experiment benchmarks/experiments/largest.toml -o LARGEST
cp LARGEST/cells/playbot/pro/rate-0.0003/seed-0/work/scene.c3gs playbot-800-0.0003.c3gs
python -m benchmarks.lengths run FOLDER --question hyperprior --scenes playbot-800-0.0003.c3gs \\
  --counts 2000 8000 20000 49465 --only "planes and gamma" constants --seeds 0 1 2
python -m benchmarks.lengths run FOLDER --question hyperprior --scenes playbot-800-0.0003.c3gs \\
  --counts 49465 --only planes gamma
python -m benchmarks.lengths run FOLDER --question planes --scenes playbot-800-0.0003.c3gs \\
  --counts 49465 --only "B doubled" "16 channels"
python -m benchmarks.lengths.bounds caliterra-0.002.c3gs playbot-800-0.0003.c3gs --work FOLDER
python -m benchmarks.lengths.moves caliterra-0.002.c3gs PHOTOGRAPHS FOLDER
refcodec train PLAYBOT -o grid-base-0 --rate 0.002 --steps 2000 --size 200 --threads 1
refcodec train PLAYBOT -o grid-coarse-0 ... --set "weights.coarser=[0, 7]" --set "weights.rendering_bits=[5, 12]"
python -m benchmarks.lengths note FOLDER grid-base-0 grid-coarse-0
python -m benchmarks.lengths table FOLDER --results
```
"""

_METHOD = """
Symbols are those of a trained file, and do not change. Networks and planes are trained anew in floating point, for 600
steps of 1,024 anchors. The sum is A, P and the weights of F_h, SARM and CARM. Rendering networks are not in it.
The loss has the bits of weights as well, unless a row says otherwise, so that each width finds its own weights.
A row's percentage is against the first row of its table.

**Rows are of one seed, where their column does not say more.** Differences of one seed below 1 % decide nothing.
playbot-800-0.0003 is the file of 49,465 anchors of the experiment `largest`. Parts of it are anchors that lie together.
"""

_VERDICTS = """
- **Weights: the largest gain, and none of the format's business.** A file of 490 anchors was two thirds weights.
  Grids up to 7 bits coarser than SPEC 7.2's integers (today 3), and rendering networks of 5 bits or more (today 8),
  take a quarter off that file at equal PSNR. Weights' bits in the loss take another quarter off A, P and coding
  networks there. At 9,694 anchors that makes no difference beside well chosen steps. It needs no syntax. Laplace
  distributions for weights do not pay.
- **Smallest networks**: F_h of constants and CARM without a hidden layer, for 490 anchors: 4.5 to 4.9 % of the sum.
  Without CARM the sum grows by 16 %. This needs a syntax: no planes and no frequencies, so that F_h has no inputs, and
  networks without hidden layers. At 9,694 anchors, linear networks cost 4 % (with contexts of scalings and offsets
  beside): hidden layers stay.
- **Planes and gamma by number of anchors**: of a scene at 800 pixels they take 0.1 ± 0.3 % off A at 2,000 anchors,
  3.05 ± 0.04 at 8,000, 3.4 ± 0.1 at 20,000 and 3.19 ± 0.04 at 49,465. P, F_h and SARM spend 0.9 ± 0.6, 1.3 ± 0.1,
  1.2 ± 0.1 and 1.0 ± 0.3 % of A. So they pay from some thousand anchors on: 1.7 to 2.2 % are left. At 49,465 gamma
  alone takes off 1.4 %, planes alone 1.6 %. That planes save over 5 % of A does not come true there.
- **Why planes save no more**: by linear prediction the others of a plane's cell save 1.0 % of features and scalings,
  even if planes cost nothing, and the eight nearest of all anchors in space, decoded or not, 2.9 % (49,465 anchors; 1.2
  and 2.5 % of 9,694). Attributes are not smooth in space. Resolution is not the limit: with a grid of twice the B it is
  1.1 %, and such planes cost 4.9 % more in all, 16 channels 0.2 % (one seed each). A training that makes features
  smooth would have to come first.
- **Neighbours as contexts**: four nearest anchors before save 1.9 %, the nearest ones of a coarser level 1.4 %, gamma
  0.4 %. The gains overlap. They pass 1 % before networks are counted, and make anchors wait for each other.
  Not for part I before a training with them shows more.
- **Scalings from features**: 0.65 % of the sum, with offsets from features 0.8 %, networks counted. Offsets from
  scalings and masks: 0.4 %. Each is under 1 %. By linear prediction scalings one by one after features save 1.6 %
  of both, against 0.6 % all at once: the best that is left untested, at the cost of five more stages.
- **Slices**: by linear prediction ten of five features save 1.3 % against 5, 10, 15, 20, and fifty of one 3.3 %, both
  before the weights of more networks. Two slices cost 10 %. Features in another order cost 3 to 4 %: a training fits
  their order to the slices. Part I should let slices be as many as features. The encoder's stay 5, 10, 15, 20.
- **Symbols moved towards their means**: scalings and offsets have next to no symbols where a move saves a bit. Features
  save 1.1 % of the file for 0.02 dB, 2.1 % for 0.04 dB, and get worse from there. That is about what a higher lambda_r
  costs, so it does not pay as it is. Moves weighed by the gradient of the image were not tried.

Not measured: default networks of a standard, contexts of masks, fine-tuning on all anchors, scenes of 100,000 anchors.
Mixtures of two distributions are measured in trainings ("Entropy models of others, with seeds").
"""

COMMANDS = _TEXT.strip().splitlines()
VERDICTS = ["", *_METHOD.strip().splitlines(), "", "### Verdicts", "", *_VERDICTS.strip().splitlines()]
