// What a recipe's stages and rates mean, step by step.
#include "model/recipe.h"

#include <gtest/gtest.h>

namespace lcdm::model {
namespace {

TEST(Stages, AreReadAndRefused) {
  const Result<Stage> stage = parse_stage("0.5:8:0.75");
  ASSERT_TRUE(stage);
  EXPECT_EQ(stage->share, 0.5);
  EXPECT_EQ(stage->images, 8);
  EXPECT_EQ(stage->until, 0.75);
  EXPECT_EQ(parse_stage("1:4:1:4e-4")->learning_rate, 4e-4);
  for (const char* text : {"", "0.5:8", "0.5:8:0.75:1", "0.5:8:0.75:", "0.5:8:0.75:1e-3:",
                           "0.5:8:1:0", "0:8:1", "0.5:0:1", "0.5:8:2", "a:b:c"}) {
    EXPECT_EQ(parse_stage(text).code(), StatusCode::kUsage) << text;
  }
}

// 100 steps: a cosine to step 50, and a second one from half the rate; the head joins at 80.
TEST(LearningRate, BeginsAgainWhereAStageNamesOne) {
  Recipe recipe;
  recipe.steps = 100;
  recipe.warm_up = 10;
  recipe.learning_rate = 1;
  recipe.final_rate = 0;
  recipe.head_from = 0.8;
  recipe.stages = {{0.5, 8, 0.2}, {0.6, 8, 0.5}, {1, 4, 1, 0.5}};
  EXPECT_DOUBLE_EQ(learning_rate_at(recipe, 0), 0.1);  // warm-up
  EXPECT_DOUBLE_EQ(learning_rate_at(recipe, 10), 1);
  EXPECT_NEAR(learning_rate_at(recipe, 30), 0.5, 1e-12);  // half-way from 10 to 50
  EXPECT_LT(learning_rate_at(recipe, 49), 0.01);
  EXPECT_DOUBLE_EQ(learning_rate_at(recipe, 50), 0.05);
  EXPECT_DOUBLE_EQ(learning_rate_at(recipe, 60), 0.5);
  EXPECT_NEAR(learning_rate_at(recipe, 80), 0.25, 1e-12);
  EXPECT_DOUBLE_EQ(head_rate_at(recipe, 80), 0.05);
  EXPECT_DOUBLE_EQ(head_rate_at(recipe, 90), 0.5);
  recipe.head_from = 0;  // joined before: the same as the others
  EXPECT_DOUBLE_EQ(head_rate_at(recipe, 70), learning_rate_at(recipe, 70));
}

}  // namespace
}  // namespace lcdm::model
