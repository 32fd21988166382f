# Reference figures for tests/analysis/test_reference_r.py.
#   Rscript reference.R > reference_r.csv        (in this folder)
# R and the packages car and MASS; every factor has sum-to-zero contrasts.
suppressMessages({library(car); library(MASS)})
options(contrasts = c("contr.sum", "contr.poly"), digits = 17)
cat("# ", R.version.string, ", car ", as.character(packageVersion("car")),
    ", made by reference.R\n", sep = "")
cat("design,analysis,term,quantity,value\n")

put <- function(design, analysis, term, quantity, value) {
  if (length(value) == 0 || is.na(value)) return(invisible())
  term <- gsub(" ", "", term)
  cat(sprintf("%s,%s,%s,%s,%.17g\n", design, analysis, term, quantity, value), sep = "")
}
column <- function(t, names) { for (n in names) if (n %in% colnames(t)) return(t[[n]]); NULL }
rows <- function(design, analysis, t, skip = "(Intercept)") {
  for (i in seq_len(nrow(t))) {
    term <- trimws(rownames(t)[i])
    if (term %in% skip) next
    put(design, analysis, term, "df", column(t, "Df")[i])
    put(design, analysis, term, "ss", column(t, c("Sum Sq", "Sum of Sq"))[i])
    f <- column(t, c("F value", "F"))[i]; p <- column(t, "Pr(>F)")[i]
    if (!is.null(f) && !is.na(f)) { put(design, analysis, term, "f", f); put(design, analysis, term, "p", p) }
  }
}
types <- function(design, formula, data) {
  fit <- lm(formula, data)
  rows(design, "I", anova(fit)); rows(design, "II", Anova(fit, type = 2))
  rows(design, "III", Anova(fit, type = 3))
  invisible(fit)
}
strata <- function(design, analysis, fit) {
  s <- summary(fit)
  for (n in names(s)) {
    t <- s[[n]][[1]]
    stratum <- gsub("Error: ", "", n)
    for (i in seq_len(nrow(t))) {
      term <- trimws(rownames(t)[i])
      where <- paste(analysis, stratum, sep = "|")
      put(design, where, term, "df", t[i, "Df"]); put(design, where, term, "ss", t[i, "Sum Sq"])
      if ("F value" %in% colnames(t) && !is.na(t[i, "F value"])) {
        put(design, where, term, "f", t[i, "F value"]); put(design, where, term, "p", t[i, "Pr(>F)"])
      }
    }
  }
}
read <- function(name) read.csv(paste0(name, ".csv"), stringsAsFactors = TRUE)

# crossed, balanced and unbalanced
d <- read("crossed"); u <- subset(d, keep == 1)
types("crossed", y ~ a * b * c, d)
fit <- types("crossed-unbalanced", y ~ a * b * c, u)
put("crossed-unbalanced", "fit", "", "s", summary(fit)$sigma)
put("crossed-unbalanced", "fit", "", "r_sq", summary(fit)$r.squared)
put("crossed-unbalanced", "fit", "", "r_sq_adj", summary(fit)$adj.r.squared)
two <- lm(y ~ a * b, u)
put("crossed-unbalanced", "two-way", "", "r_sq_pred",
    1 - sum((resid(two) / (1 - hatvalues(two)))^2) / sum((u$y - mean(u$y))^2))
put("crossed-unbalanced", "two-way", "", "max_leverage", max(hatvalues(two)))
put("crossed-unbalanced", "two-way", "", "max_cook", max(cooks.distance(two)))
rows("crossed-unbalanced", "HC3", {
  t <- Anova(two, type = 3, white.adjust = "hc3"); t[["Sum Sq"]] <- NA; t })
grid <- expand.grid(b = levels(u$b), a = levels(u$a))
X <- model.matrix(~ a * b, grid)
for (level in levels(u$a)) {
  l <- colMeans(X[grid$a == level, ])
  m <- sum(l * coef(two)); se <- sqrt(drop(t(l) %*% vcov(two) %*% l))
  h <- qt(.975, two$df.residual) * se
  put("crossed-unbalanced", "mean", level, "mean", m)
  put("crossed-unbalanced", "mean", level, "low", m - h)
  put("crossed-unbalanced", "mean", level, "high", m + h)
}
cell <- interaction(u$a, u$b)
b <- bartlett.test(u$y, cell)
put("crossed-unbalanced", "bartlett", "", "statistic", b$statistic)
put("crossed-unbalanced", "bartlett", "", "p", b$p.value)
for (center in c("median", "mean")) {
  l <- leveneTest(u$y, cell, center = get(center))
  put("crossed-unbalanced", paste0("levene-", center), "", "statistic", l[1, "F value"])
  put("crossed-unbalanced", paste0("levene-", center), "", "p", l[1, "Pr(>F)"])
}
w <- oneway.test(y ~ a, u)
put("crossed-unbalanced", "welch", "a", "f", w$statistic); put("crossed-unbalanced", "welch", "a", "p", w$p.value)
w <- shapiro.test(resid(two))
put("crossed-unbalanced", "shapiro", "", "statistic", w$statistic)
bc <- function(e) {
  g <- exp(mean(log(u$y))); z <- if (abs(e) < 1e-9) g * log(u$y) else (u$y^e - 1) / (e * g^(e - 1))
  -nrow(u) / 2 * log(sum(resid(lm(z ~ a * b, u))^2))
}
best <- optimize(bc, c(-10, 10), maximum = TRUE, tol = 1e-10)
edge <- function(from, to) uniroot(function(e) bc(e) - best$objective + qchisq(.95, 1) / 2, c(from, to), tol = 1e-10)$root
put("crossed-unbalanced", "boxcox", "", "low", edge(best$maximum - 10, best$maximum))
put("crossed-unbalanced", "boxcox", "", "high", edge(best$maximum, best$maximum + 10))

# complete blocks, blocks with lost runs, incomplete blocks, Latin square
d <- read("blocked")
types("blocked", y ~ s + a * b, d); types("blocked-unbalanced", y ~ s + a * b, subset(d, keep == 1))
d <- read("incomplete"); types("incomplete", y ~ k + t, d)
d <- read("latin"); types("latin", y ~ r + c + t, d)

# nested: specimens in mixes, and the mixes against them
d <- read("nested"); d$specimen <- factor(d$specimen); u <- subset(d, keep == 1)
rows("nested", "I", anova(lm(y ~ mix / specimen, d)))
rows("nested-unbalanced", "I", anova(lm(y ~ mix / specimen, u)))
strata("nested", "strata", aov(y ~ mix + Error(mix:specimen), d))

# split plots
d <- read("splitplot"); u <- subset(d, keep == 1)
strata("splitplot", "strata", aov(y ~ mix * speed + Error(specimen), d))
strata("splitplot-unbalanced", "strata", aov(y ~ mix * speed + Error(specimen), u))
strata("splitblocks", "strata", aov(y ~ v * n + Error(k / v), read("splitblocks")))

# repeated measures: own interactions with Greenhouse-Geisser
own <- function(design, wide, between, idata, idesign, type) {
  fit <- lm(as.formula(paste("wide ~", between)), attr(wide, "data"))
  s <- summary(Anova(fit, idata = idata, idesign = idesign, type = type), multivariate = FALSE)
  t <- s$univariate.tests; e <- s$pval.adjustments; m <- s$sphericity.tests
  kind <- paste0("own-", as.character(as.roman(type)))
  for (n in setdiff(rownames(t), "(Intercept)")) {
    put(design, kind, n, "ss", t[n, "Sum Sq"]); put(design, kind, n, "df", t[n, "num Df"])
    put(design, kind, n, "ss_error", t[n, "Error SS"]); put(design, kind, n, "df_error", t[n, "den Df"])
    put(design, kind, n, "f", t[n, "F value"]); put(design, kind, n, "p", t[n, "Pr(>F)"])
  }
  for (n in rownames(e)) {
    put(design, kind, n, "epsilon_gg", e[n, "GG eps"]); put(design, kind, n, "p_gg", e[n, "Pr(>F[GG])"])
    put(design, kind, n, "mauchly_w", m[n, "Test statistic"]); put(design, kind, n, "mauchly_p", m[n, "p-value"])
  }
}
d <- read("repeated"); d <- d[order(d$s, d$a, d$b), ]
wide <- matrix(d$y, ncol = 9, byrow = TRUE)
idata <- expand.grid(b = levels(d$b), a = levels(d$a))
attr(wide, "data") <- data.frame(one = rep(1, 8))
own("repeated", wide, "1", idata, ~ a * b, 3)
d <- read("splitplot"); d <- d[order(d$specimen, d$speed), ]
for (lost in c("", "s12")) {
  e <- droplevels(subset(d, specimen != lost)); n <- nrow(e) / 4
  wide <- matrix(e$y, ncol = 4, byrow = TRUE)
  attr(wide, "data") <- data.frame(mix = e$mix[seq(1, nrow(e), 4)])
  idata <- data.frame(speed = factor(levels(d$speed)))
  name <- if (lost == "") "splitplot" else "splitplot-uneven"
  own(name, wide, "mix", idata, ~ speed, 2); own(name, wide, "mix", idata, ~ speed, 3)
}

# fractional 2^(4-1), D = ABC: main effects and the three two-way terms that are not aliased
d <- read("fraction"); for (n in c("A", "B", "C", "D")) d[[n]] <- factor(d[[n]])
types("fraction", y ~ A + B + C + D + A:B + A:C + B:C, d)
