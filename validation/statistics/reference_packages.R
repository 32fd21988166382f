# Reference figures for tests/analysis/test_reference_packages.py.
#   Rscript reference_packages.R > reference_packages.csv        (in this folder)
# R and the packages emmeans (simple effects, named contrasts) and lme4 (variance components);
# second-order surfaces by lm and eigen, which is what the package rsm does.
suppressMessages({library(emmeans); library(lme4)})
options(contrasts = c("contr.sum", "contr.poly"), digits = 17)
cat("# ", R.version.string, ", emmeans ", as.character(packageVersion("emmeans")),
    ", lme4 ", as.character(packageVersion("lme4")), ", made by reference_packages.R\n", sep = "")
cat("design,analysis,term,quantity,value\n")
put <- function(design, analysis, term, quantity, value)
  cat(sprintf("%s,%s,%s,%s,%.17g\n", design, analysis, term, quantity, value), sep = "")
read <- function(name) read.csv(paste0(name, ".csv"), stringsAsFactors = TRUE)

# simple effects of a at every setting of b and c, balanced and unbalanced
simple <- function(design, d) {
  fit <- lm(y ~ a * b * c, d)
  t <- as.data.frame(summary(pairs(emmeans(fit, ~ a | b * c)), adjust = "none"))
  for (i in seq_len(nrow(t))) {
    term <- gsub(" ", "", paste(t$contrast[i], t$b[i], t$c[i], sep = "|"))
    put(design, "simple", term, "difference", t$estimate[i])
    put(design, "simple", term, "error", t$SE[i])
    put(design, "simple", term, "df", t$df[i])
    put(design, "simple", term, "p", t$p.value[i])
  }
  t <- as.data.frame(summary(contrast(emmeans(fit, ~ a * b), list(own = c(1, 0, 0, -1, 0, 0)))))
  for (q in c("estimate", "SE", "p.value")) put(design, "contrast", "a1|b1-a1|b2", q, t[[q]])
}
d <- read("crossed"); simple("crossed", d); simple("crossed-unbalanced", subset(d, keep == 1))

# one random factor: incomplete blocks, by REML
d <- read("incomplete")
fit <- lmer(y ~ t + (1 | k), d, REML = TRUE,
            control = lmerControl(optCtrl = list(xtol_abs = 1e-10, ftol_abs = 1e-12)))
v <- as.data.frame(VarCorr(fit))
put("incomplete", "reml", "k", "sd", v$sdcor[1]); put("incomplete", "reml", "within", "sd", v$sdcor[2])

# central composite design of Montgomery, example 11.2, in coded variables
d <- read("chemical_process"); x <- (d[[1]] - 85) / 5; z <- (d[[2]] - 175) / 5; y <- d[["yield"]]
fit <- lm(y ~ x + z + I(x^2) + I(z^2) + x:z); b <- coef(fit)
names(b) <- c("1", "x", "z", "x^2", "z^2", "x*z")
for (n in names(b)) put("chemical_process", "surface", n, "coefficient", b[[n]])
B <- matrix(c(b["x^2"], b["x*z"] / 2, b["x*z"] / 2, b["z^2"]), 2)
s <- -solve(B, b[c("x", "z")]) / 2
put("chemical_process", "surface", "x", "stationary", s[1])
put("chemical_process", "surface", "z", "stationary", s[2])
e <- sort(eigen(B)$values)
put("chemical_process", "surface", "1", "eigenvalue", e[1])
put("chemical_process", "surface", "2", "eigenvalue", e[2])
a <- anova(fit, lm(y ~ factor(x) * factor(z)))
put("chemical_process", "surface", "", "lack_of_fit_F", a$F[2])
put("chemical_process", "surface", "", "lack_of_fit_p", a$`Pr(>F)`[2])

# a composite design of Box and Wilson in four factors: paper helicopters of Box, Hunter and
# Hunter, without the term of its two blocks, to which linear terms and products are orthogonal
d <- read("paper_helicopter"); names(d) <- c("A", "R", "W", "L", "y")
d <- with(d, data.frame(a = (A - 12.4) / .6, r = (R - 2.52) / .26, w = (W - 1.25) / .25,
                        l = (L - 2) / .5, y = y))
fit <- lm(y ~ (a + r + w + l)^2 + I(a^2) + I(r^2) + I(w^2) + I(l^2), d); b <- coef(fit)
names(b) <- sub("^I\\((.*)\\)$", "\\1", sub("\\(Intercept\\)", "1", names(b)))
for (n in names(b)) put("paper_helicopter", "surface", n, "coefficient", b[[n]])
v <- c("a", "r", "w", "l"); B <- matrix(0, 4, 4, dimnames = list(v, v))
for (i in 1:4) for (j in 1:4) B[i, j] <- if (i == j) b[paste0(v[i], "^2")] else
  b[paste(v[min(i, j)], v[max(i, j)], sep = ":")] / 2
s <- -solve(B, b[v]) / 2
for (n in v) put("paper_helicopter", "surface", n, "stationary", s[[n]])
e <- sort(eigen(B)$values)
for (k in 1:4) put("paper_helicopter", "surface", k, "eigenvalue", e[k])
a <- anova(fit, lm(y ~ interaction(a, r, w, l, drop = TRUE), d))
put("paper_helicopter", "surface", "", "lack_of_fit_F", a$F[2])
put("paper_helicopter", "surface", "", "lack_of_fit_p", a$`Pr(>F)`[2])
