% Reads an fdata matrix as SIDPAC's programs do (its channel list), and makes of it what they begin with: the lift
% coefficient and a least-squares fit of it, as SIDPAC's lesq.m gives it: theta = (X'X)\X'z, errors by the residual.
function fdata_in_octave(name)
  load(name);
  dtr = pi/180; g = 32.174;
  t = fdata(:,1); alpha = fdata(:,4)*dtr; q = fdata(:,6)*dtr; de = fdata(:,14)*dtr;
  mass = fdata(:,48); qbar = fdata(:,27); V = fdata(:,2);
  sarea = fdata(1,77); cbar = fdata(1,79);
  CZ = fdata(:,13)*g.*mass./(qbar*sarea);
  CX = fdata(:,11)*g.*mass./(qbar*sarea);
  CL = -CZ.*cos(alpha) + CX.*sin(alpha);
  X = [alpha, q*cbar./(2*V), de, ones(size(t))];
  theta = (X'*X)\(X'*CL);
  printf('%d %d\n', size(fdata));
  printf('%.15g\n', theta);
end
