// The one way this folder sees LibTorch; compiled ahead (see CMakeLists.txt).
#pragma once

#include <torch/torch.h>
